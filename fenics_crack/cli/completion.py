"""What the shell completes: commands, their options, and the keys of a scene behind ``--set``.

The program prints a script that the shell reads once; nothing of the program runs when a key is
pressed. Zsh reads bash's by its own ``bashcompinit``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

__all__ = ["script"]

BASH = """\
_fenics_crack() {{
    local words=""
    case "$3" in
{before}
        fenics-crack) words="{commands}" ;;
        *) case "${{COMP_WORDS[1]}}" in
{options}
        esac
        [[ "$2" == -* ]] || words="" ;;
    esac
    COMPREPLY=($(compgen -W "$words" -- "$2"))
}}
complete -o default -F _fenics_crack fenics-crack
"""
ZSH = "autoload -Uz compinit bashcompinit && compinit && bashcompinit\n"
FISH = "complete -c fenics-crack -n "


def script(
    shell: str,
    commands: Mapping[str, tuple[str, Sequence[str]]],
    values: Mapping[str, Sequence[str]],
) -> str:
    """What a shell is to read: commands with what they do and their options, and what may stand
    behind some options."""
    if shell == "fish":
        return "\n".join([*_fish(commands, values), ""])
    before = [f'        {name}) words="{" ".join(known)}" ;;' for name, known in values.items()]
    options = [f'            {name}) words="{" ".join(o)}" ;;' for name, (_, o) in commands.items()]
    parts = {"before": "\n".join(before), "options": "\n".join(options)}
    return (ZSH if shell == "zsh" else "") + BASH.format(commands=" ".join(commands), **parts)


def _fish(
    commands: Mapping[str, tuple[str, Sequence[str]]], values: Mapping[str, Sequence[str]]
) -> list[str]:
    lines = []
    for name, (text, options) in commands.items():
        lines.append(f"{FISH}__fish_use_subcommand -f -a {name} -d {text!r}")
        for option in options:
            known = f" -x -a {' '.join(values[option])!r}" if option in values else ""
            lines.append(f"{FISH}'__fish_seen_subcommand_from {name}' -l {option[2:]}{known}")
    return lines
