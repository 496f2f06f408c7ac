"""Suggestions for a name that does not exist, misspelt or another program's word for it, and for a
number with a decimal comma or in another unit.

Whoever refuses one asks here what to suggest: keys and values of a scene, commands, names of the
package, and arguments of its functions.
"""

from __future__ import annotations

import functools
import math
import os
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from numbers import Integral, Real
from typing import Any, TypeVar, cast

from fenics_crack.basics.errors import InputError

Function = TypeVar("Function", bound=Callable[..., Any])

MIN_LIKENESS = 0.7
"""Minimum likeness of a misspelt word and the suggested one (difflib's ratio)."""
SAME_WORD_LIKENESS = 0.85
"""Likeness of two forms of a word, as "eigenfrequency" and "eigenfrequencies"."""
SEARCH_WORDS_BY_CALL = {
    "fc.solve(scene)": "solve steady periodic stationary forced vibration balance hbm run compute "
    "newton",
    "fc.curve(scene)": "curve frf frequency response continuation nlfr path resonance",
    "fc.curve(scene).peak()": "peak max maximum largest highest resonance resonant argmax damping",
    "fc.integrate(scene)": "time transient simulate simulation march newmark ode ivp odeint "
    "history dynamics",
    "fc.modes(scene)": "modal modes eigen eigenmodes eigenfrequencies eigenvalues natural",
    "fc.run_sweep(scene)": "sweep study parameter parametric batch scan map campaign",
    "fc.load_run(path)": "load read open import restore result solution hdf5",
    "fc.Scene.load(path)": "load read open import from file scene toml model plate material crack "
    "geometry rectangle box problem",
    "fc.build_structure(scene), with mesh.file in it": "load read open import mesh msh gmsh",
    "fc.save(result, path, scene)": "save write dump export store hdf5 toml",
    "result.to_dict()": "dataframe frame pandas numpy dict csv excel",
    "fc.draw_curve(curve, ax=ax), fc.draw_waves(...), ...": "plot draw figure picture chart axes",
    "fc.solve(scene).indicators().ratio_2_1": "ratio harmonic harmonics superharmonic second "
    "indicator",
    "fc.solve(scene).stability.verdict": "stable stability unstable floquet verdict lyapunov",
    "fc.stress_intensity(run)": "stress sif tip intensity factor",
    "fc.write_period(solution, path, material=scene.material)": "stress stresses mises strain vtk "
    "paraview",
    "fc.solve(scene).report": "error errors accuracy residual uncertainty",
    "result.frequency": "frequency frequencies freq freqs hertz omega",
    "result.displacement(time)": "displacement displacements x u q solution vector mode shape",
    "result.time": "t times instants",
}
"""Calls to write, by the words that other programs and people have for them; what several kinds of
results have is of a "result"."""
OWN_VERB_BY_FOREIGN_VERB = {"plot": "draw", "show": "draw", "read": "load", "export": "write"}
"""First words of names, and those of this package for the same."""


DESCRIPTION_BY_CLASS_NAME = {
    "Scene": "a Scene, as fc.Scene.load(path) returns", "Path": "a path", "str": "a text",
    "Mapping": "a dict", "None": "None", "Run": "a Run, as fc.solve(scene) returns",
    "bool": "True or False", "Iterable": "a list of values", "int": "a whole number",
    "float": "a number",
}  # fmt: skip
"""Words for classes of arguments; those of Python's own are always compared."""
FACTOR_BY_UNIT_PREFIX = {
    "G": 1e9,
    "M": 1e6,
    "k": 1e3,
    "": 1.0,
    "c": 1e-2,
    "m": 1e-3,
    "u": 1e-6,
    "n": 1e-9,
}
FOREIGN_UNIT_FACTORS = {
    "kg/m^3": {"g/cm^3": 1e3, "kg/dm^3": 1e3, "t/m^3": 1e3, "t/mm^3": 1e12},
    "Pa": {"N/mm^2": 1e6, "N/m^2": 1.0},
    "N/m": {"N/mm": 1e3},
    "N/m^3": {"N/mm^3": 1e9},
    "m/s^2": {"g": 9.80665},
    "": {"%": 1e-2},
}
"""Units of others by a key's unit, and what they are in that."""
UNIT_SPELLING_TABLE = str.maketrans({"µ": "u", "μ": "u", "²": "^2", "³": "^3", "·": " "})
NUMBER_WITH_UNIT_PATTERN = re.compile(r"([+-]?\d*(?:[.,]\d*)?(?:[eE][+-]?\d+)?) *([^\d].*)?")


def find_similar_names(
    word: object, known: Iterable[str], likeness: float = MIN_LIKENESS
) -> list[str]:
    """The known word that a misspelt one may stand for, or two that are as near; or none."""
    import difflib  # takes a while, and mistakes alone need it

    by_lower, lower = {name.lower(): name for name in known}, str(word).lower()[:100]
    found = difflib.get_close_matches(lower, by_lower, 2, likeness)
    ratios = [difflib.SequenceMatcher(None, name, lower).ratio() for name in found]
    return [by_lower[name] for name, one in zip(found, ratios, strict=True) if one == ratios[0]]


def find_similar_or_longer_names(
    name: str, known: Collection[str], likeness: float = MIN_LIKENESS
) -> list[str]:
    """The same, or the known names in which a short one begins a word, as "tol" "tolerance"."""
    begun = re.compile(f"(^|_){re.escape(name)}", re.IGNORECASE)
    longer = [other for other in known if begun.search(other) and len(name) >= 3]
    return find_similar_names(name, known, likeness) or sorted(longer, key=len)


def find_calls_by_synonyms(name: str) -> list[str]:
    """Return the calls to write for a name in the words of others: those that share the most of its
    words, or none. Those of a result are left out where there are functions."""
    parts = re.findall("[a-z0-9]+", re.sub("([A-Z])", r"_\1", name[:100]).lower())
    counts = {
        text: sum(
            bool(find_similar_names(part, words.split(), SAME_WORD_LIKENESS)) for part in parts
        )
        for text, words in SEARCH_WORDS_BY_CALL.items()
    }
    most = max(counts.values())
    calls = [text for text, count in counts.items() if count == most > 0]
    return [text for text in calls if text.startswith("fc.")] or calls


def did_you_mean_text(names: Sequence[str]) -> str:
    """A question after what may be meant, with a space behind it; empty if there is nothing."""
    return f"did you mean {' or '.join(names[:3])}? " if names else ""


def suggest_replacements(name: str, known: Sequence[str]) -> str:
    """A question after what may be meant by a name that the package, with its known names, does not
    have; empty if nothing is similar."""
    if name.startswith("_"):  # notebooks and test programs ask for such names of anything
        return ""
    others = find_calls_by_synonyms(name)
    verb, _, rest = name.partition("_")
    same = (
        find_similar_names(f"{OWN_VERB_BY_FOREIGN_VERB[verb]}_{rest}", known)
        if rest and verb in OWN_VERB_BY_FOREIGN_VERB
        else []
    )
    if same:
        return did_you_mean_text([f"fc.{other}" for other in same])
    similar = (
        find_similar_names(name, known, SAME_WORD_LIKENESS)
        if others
        else find_similar_or_longer_names(name, known)
    )
    similar = [other for other in similar if not any(other in text for text in others)]
    return did_you_mean_text([*(f"fc.{other}" for other in similar), *others])


def check_options(whose: str, options: Mapping[str, object], known: Collection[str]) -> None:
    """Raise InputError for a keyword that is no option of a function."""
    for key, value in options.items():
        if key not in known:
            question = did_you_mean_text(find_similar_or_longer_names(key, known))
            allowed = f"left out; {question}the options of {whose} are {', '.join(known)}"
            raise InputError(key, value, allowed)


def _class_names_of(value: object) -> set[str]:
    """Return the names of the classes that a value is of."""
    names = {base.__name__.removesuffix("_") for base in type(value).__mro__}  # also NumPy's bool_
    kinds_by_name: dict[str, Any] = {"Mapping": Mapping, "Path": os.PathLike, "None": type(None)}
    kinds_by_name |= {"Iterable": Iterable, "int": Integral, "float": Real}
    return names | {name for name, kind in kinds_by_name.items() if isinstance(value, kind)}


def fit_argument(key: str, value: Any, annotation: str, kinds: Collection[str]) -> Any:
    """Return an argument that fits an annotation: the value, or the result of a Run.

    Raise InputError where all alternatives of the annotation are among some kinds, and the value is
    of none of them; which words are allowed each function says. Classes are compared by their
    names: no module is imported for that.
    """
    class_names = list(dict.fromkeys(part.partition("[")[0] for part in annotation.split(" | ")))
    names = _class_names_of(value)
    if {"str"} != {*class_names} <= {*kinds, *DESCRIPTION_BY_CLASS_NAME} and names.isdisjoint(
        class_names
    ):
        if "Run" in names and not _class_names_of(value.result).isdisjoint(class_names):
            return value.result
        is_plain = isinstance(value, str | int | float | None)
        words = (
            DESCRIPTION_BY_CLASS_NAME.get(n) or f"a{'n' * (n[0] in 'AEIO')} {n}"
            for n in class_names
        )
        raise InputError(key, value if is_plain else type(value).__name__, " or ".join(words))
    return value


def check_calls(
    function: Function,
    keys: Callable[[str], Sequence[str]] | None = None,
    kinds: Collection[str] = (),
) -> Function:
    """Decorate a function so that it refuses a call that does not fit it, with what may be meant.

    That is another argument, a key of the scene that ``keys`` finds for it, or another function. A
    ``comm`` that is no communicator is refused, too, and what is of none of the ``kinds`` of its
    annotation; of a Run its result is taken where that is of these.
    """
    from inspect import signature as signature_of  # takes a while: not for the program

    signature = signature_of(function)
    open_ended = any(one.kind is one.VAR_KEYWORD for one in signature.parameters.values())
    known = [name for name, one in signature.parameters.items() if one.kind is not one.VAR_KEYWORD]
    known = [name for name in known if name not in ("self", "cls")]
    named = {name for name, one in signature.parameters.items() if one.kind is one.KEYWORD_ONLY}
    shown = [f"{name}=..." if name in named else name for name in known]

    @functools.wraps(function)
    def call(*args: Any, **options: Any) -> Any:
        try:
            bound = signature.bind(*args, **options)
        except TypeError as error:
            name, reason = function.__name__, str(error)
            wrong = next((one for one in options if one not in signature.parameters), None)
            if reason == "too many positional arguments":
                names = []
            elif wrong is None or open_ended:
                names = [text for text in find_calls_by_synonyms(name) if f"fc.{name}(" not in text]
            else:
                reason = f"got an unexpected keyword argument {wrong!r}"
                names = find_similar_or_longer_names(wrong, known)
                if not names and keys is not None:
                    names = [f'scene.replace({{"{key}": ...}})' for key in keys(wrong)]
            question = f"{did_you_mean_text(names)}its arguments are {', '.join(shown)}"
            raise TypeError(f"{name}() {reason}; {question}") from None
        given = bound.arguments
        if "comm" in given:
            from fenics_crack.basics.ranks import check_communicator

            check_communicator(given["comm"])
        for name, value in given.items():
            annotation = str(signature.parameters[name].annotation)
            given[name] = fit_argument(name, value, annotation, kinds)
        return function(*bound.args, **bound.kwargs)

    return cast(Function, call)


# --- numbers --------------------------------------------------------------------------------------


def convert_number(text: str, unit: str) -> float | None:
    """A number with a decimal comma, or in another unit than a key's, in that of the key."""
    found = NUMBER_WITH_UNIT_PATTERN.fullmatch(text.strip()[:100].translate(UNIT_SPELLING_TABLE))
    try:
        value = float(found[1].replace(",", ".")) if found else None
    except ValueError:
        return None
    if found is None or value is None:
        return None
    given = re.sub(r"([a-z])([23])\b", r"\1^\2", (found[2] or unit).strip())
    if given == unit:
        return value
    factor = FOREIGN_UNIT_FACTORS.get(unit, {}).get(given)
    if factor is None and unit and given.endswith(unit):
        factor = FACTOR_BY_UNIT_PREFIX.get(given.removesuffix(unit))
    if factor is None or not math.isfinite(value * factor):
        return None
    return float(f"{value * factor:.12g}")  # no 0.30000000000000004


def yield_candidate_values(value: object, unit: str) -> Iterator[object]:
    """Yield the values that may be meant by one that is no number, or no list of numbers."""
    if isinstance(value, str):
        number = convert_number(value, unit)
        yield number
        if number is not None and number.is_integer():
            yield int(number)
        value = value.strip("[] ").split(",")
    if isinstance(value, list | tuple):
        yield [convert_number(one, unit) if isinstance(one, str) else one for one in value]


def format_scene_value(value: object) -> str:
    """A value as a scene has it, numbers in short: "2.1e+11"."""
    short = f"{value:g}" if isinstance(value, float) else ""
    return short if short and float(short) == value else repr(value)
