"""Suggest a replacement for a wrong name or number.

A wrong name may be misspelt, or another program's word. A wrong number may have a decimal comma or
another unit. The functions serve errors about keys and values of a scene, commands, names of the
package, and arguments of functions.
"""

from __future__ import annotations

import functools
import math
import os
import re
import warnings
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from numbers import Integral, Real
from typing import Any, TypeVar, cast

from fenics_crack.basics.errors import InputError

Function = TypeVar("Function", bound=Callable[..., Any])
Class = TypeVar("Class")

MIN_SUGGESTION_LIKENESS = 0.7
"""Minimum likeness of a misspelt word and the suggested word (ratio of difflib)."""
MIN_SAME_WORD_LIKENESS = 0.85
"""Minimum likeness of two forms of a word, as "eigenfrequency" and "eigenfrequencies" (difflib)."""
SEARCH_WORDS_BY_CALL = {
    "fc.solve(scene)": "solve steady periodic stationary forced vibration balance hbm run compute "
    "newton",
    "fc.curve(scene)": "curve frf frequency response continuation nlfr path resonance",
    "fc.follow_resonance(problem, start, end)": "backbone nnm",
    "fc.curve(scene).peak()": "peak max maximum largest highest resonance resonant argmax damping",
    "fc.integrate(scene)": "time transient simulate simulation march newmark ode ivp odeint "
    "history dynamics",
    "fc.modes(scene)": "modal modes eigen eigenmodes eigenfrequencies eigenvalues natural",
    "fc.run_sweep(scene)": "sweep study parameter parametric batch scan map campaign",
    "fc.load_run(path)": "load read open import restore result solution hdf5",
    "fc.Scene.load(path)": "load read open import from file scene toml model plate material crack "
    "geometry rectangle box problem",
    "fc.Structure.from_matrices(mass, stiffness, gap=...)": "from matrices matrix",
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
"""Search words for each call: names in other programs and everyday words.

"result" in a call stands for several kinds of results.
"""
OWN_VERB_BY_FOREIGN_VERB = {"plot": "draw", "show": "draw", "read": "load", "export": "write"}
"""First word of this package's names, by the first word of names in other programs."""


ARGUMENT_DESCRIPTION_BY_CLASS_NAME = {
    "Scene": "a Scene, as fc.Scene.load(path) returns", "Path": "a path", "str": "a text",
    "Mapping": "a dict", "None": "None", "Run": "a Run, as fc.solve(scene) returns",
    "ResponseCurve": "a ResponseCurve, as fc.curve(scene).result",
    "PeriodicSolution": "a PeriodicSolution, as fc.solve(scene).result",
    "Structure": "a Structure, as fc.build_structure(scene) returns",
    "Amplification": "an Amplification, as fc.amplification(scene) returns",
    "ArrivalTimes": "an ArrivalTimes, as fc.ArrivalTimes.from_csv(path) or fc.tip_timing returns",
    "Bifurcation": "a Bifurcation, from curve.bifurcations",
    "Campbell": "a Campbell, as fc.campbell(scene) returns",
    "Growth": "a Growth, as fc.grow(scene) returns",
    "Identification": "an Identification, as fc.identify(scene, measurements) returns",
    "Measurements": "a Measurements, as fc.Measurements.read(path) returns",
    "Modes": "a Modes, as fc.solve_modes returns",
    "NodalDiameters": "a NodalDiameters, as fc.nodal_diameters(scene) returns",
    "Problem": "a Problem, as fc.Problem(structure, omega, contact) returns",
    "StressIntensity": "a StressIntensity, as fc.stress_intensity(run) returns",
    "Study": "a Study, as fc.prepare(scene) returns",
    "TipFit": "a TipFit, as fc.fit_order(arrivals) returns",
    "TipTrack": "a TipTrack, as fc.track_order returns",
    "Verification": "a Verification, as fc.verify(scene) returns",
    "bool": "True or False", "Iterable": "a list of values", "int": "a whole number",
    "float": "a number",
}  # fmt: skip
"""Words for an argument's class in errors, by class name.

An argument with an annotation of these classes is always checked.
"""
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
"""Factor from a prefixed unit to the unit."""
FACTORS_FROM_OTHER_UNITS_BY_UNIT = {
    "kg/m^3": {"g/cm^3": 1e3, "kg/dm^3": 1e3, "t/m^3": 1e3, "t/mm^3": 1e12},
    "Pa": {"N/mm^2": 1e6, "N/m^2": 1.0},
    "N/m": {"N/mm": 1e3},
    "N/m^3": {"N/mm^3": 1e9},
    "m/s^2": {"g": 9.80665},
    "": {"%": 1e-2},
}
"""Factors from other units to a scene key's unit: first the key's unit, then the other unit."""
UNIT_SPELLING_TABLE = str.maketrans({"µ": "u", "μ": "u", "²": "^2", "³": "^3", "·": " "})
"""Table for ``str.translate`` from other spellings of units to the package's spelling."""
NUMBER_WITH_UNIT_PATTERN = re.compile(r"([+-]?\d*(?:[.,]\d*)?(?:[eE][+-]?\d+)?) *([^\d].*)?")
"""Pattern of a number with a unit; the two groups may be empty."""


def find_similar_names(
    word: object, known_names: Iterable[str], min_likeness: float = MIN_SUGGESTION_LIKENESS
) -> list[str]:
    """Return the known name most similar to a word, as a list.

    The list has two names if both are equally similar. It is empty if the likeness of all names is
    below ``min_likeness``: the ratio in difflib, 0 (different) to 1 (equal).
    """
    import difflib  # takes a while, and mistakes alone need it

    name_by_lower_case = {name.lower(): name for name in known_names}
    lower_word = str(word).lower()[:100]
    similar_names = difflib.get_close_matches(lower_word, name_by_lower_case, 2, min_likeness)
    likeness_ratios = [
        difflib.SequenceMatcher(None, name, lower_word).ratio() for name in similar_names
    ]
    return [
        name_by_lower_case[name]
        for name, likeness in zip(similar_names, likeness_ratios, strict=True)
        if likeness == likeness_ratios[0]
    ]


def find_similar_or_longer_names(
    name: str, known_names: Collection[str], min_likeness: float = MIN_SUGGESTION_LIKENESS
) -> list[str]:
    """Return known names similar to a name, or else longer names.

    Similar names come from :func:`find_similar_names`. If there is none, names are returned that
    contain the given name at the beginning of a word: "tol" finds "tolerance". The shortest comes
    first. A given name of one or two letters finds no longer names.

    Parameters
    ----------
    name : str
        Name to find, in which the user may have made an error.
    known_names : collection of str
        Names to choose from.
    min_likeness : float
        Minimum likeness of similar names: the ratio in difflib, 0 (different) to 1 (equal).
    """
    beginning_pattern = re.compile(f"(^|_){re.escape(name)}", re.IGNORECASE)
    longer_names = [
        known_name
        for known_name in known_names
        if beginning_pattern.search(known_name) and len(name) >= 3
    ]
    last_words = [
        known_name for known_name in known_names if name[:1].isupper() and known_name.endswith(name)
    ]
    return (
        last_words
        or find_similar_names(name, known_names, min_likeness)
        or sorted(longer_names, key=len)
    )


def find_calls_by_synonyms(name: str) -> list[str]:
    """Return calls of the package, such as "fc.solve(scene)", for a name unknown to it.

    Used to suggest a function if the user writes the name from another program.
    :data:`SEARCH_WORDS_BY_CALL` has search words for each call. The calls with the most matching
    words in the name are returned; none if no word matches. If functions ``fc....`` match, methods
    of a result are left out.
    """
    name_words = re.findall("[a-z0-9]+", re.sub("([A-Z])", r"_\1", name[:100]).lower())
    n_matches_by_call = {
        call_text: sum(
            bool(find_similar_names(name_word, search_words_text.split(), MIN_SAME_WORD_LIKENESS))
            for name_word in name_words
        )
        for call_text, search_words_text in SEARCH_WORDS_BY_CALL.items()
    }
    largest_match_count = max(n_matches_by_call.values())
    call_texts = [
        call_text
        for call_text, n_matches in n_matches_by_call.items()
        if n_matches == largest_match_count > 0
    ]
    return [call_text for call_text in call_texts if call_text.startswith("fc.")] or call_texts


def did_you_mean_text(suggested_names: Sequence[str]) -> str:
    """Return the question "did you mean a or b? " with up to three names.

    The text is empty if no name is given.
    """
    return f"did you mean {' or '.join(suggested_names[:3])}? " if suggested_names else ""


def replacement_question_text(name: str, known_names: Sequence[str]) -> str:
    """Return the question "did you mean ...? " for a name missing in the package.

    The text is empty for a private name, or without a suggestion. ``known_names`` are the names in
    the package.
    """
    if name.startswith("_"):  # notebooks and test programs ask for such names of anything
        return ""
    synonym_call_texts = find_calls_by_synonyms(name)
    first_word_of_name, _, name_without_first_word = name.partition("_")
    known_names_with_replaced_verb = (
        find_similar_names(
            f"{OWN_VERB_BY_FOREIGN_VERB[first_word_of_name]}_{name_without_first_word}", known_names
        )
        if name_without_first_word and first_word_of_name in OWN_VERB_BY_FOREIGN_VERB
        else []
    )
    if known_names_with_replaced_verb:
        return did_you_mean_text(
            [f"fc.{known_name}" for known_name in known_names_with_replaced_verb]
        )
    similar_names = (
        find_similar_names(name, known_names, MIN_SAME_WORD_LIKENESS)
        if synonym_call_texts
        else find_similar_or_longer_names(name, known_names)
    )
    similar_names = [
        known_name
        for known_name in similar_names
        if not any(known_name in call_text for call_text in synonym_call_texts)
    ]
    return did_you_mean_text(
        [*(f"fc.{known_name}" for known_name in similar_names), *synonym_call_texts]
    )


def check_options(
    owner_words: str, options: Mapping[str, object], option_names: Collection[str]
) -> None:
    """Raise InputError for an option that is not in ``option_names``.

    ``options`` are values by option name. ``owner_words`` is text for the error: the function, or
    the pictures, to which the options belong.
    """
    for key, value in options.items():
        if key not in option_names:
            question_text = did_you_mean_text(find_similar_or_longer_names(key, option_names))
            requirement_text = (
                f"left out; {question_text}the options of {owner_words} are "
                f"{', '.join(option_names)}"
            )
            raise InputError(key, value, requirement_text)


def _class_names_of(value: object) -> set[str]:
    """Return the names of a value's class and base classes.

    "Mapping", "Path", "None", "Iterable", "int" and "float" are added if the value can serve as
    such. A NumPy integer, for example, also has the name "int".
    """
    # The name of NumPy's bool_ becomes that of Python's.
    class_names = {
        value_base_class.__name__.removesuffix("_") for value_base_class in type(value).__mro__
    }
    abstract_class_by_name: dict[str, Any] = {
        "Mapping": Mapping, "Path": os.PathLike, "None": type(None), "Iterable": Iterable,
        "int": Integral, "float": Real,
    }  # fmt: skip
    return class_names | {
        name
        for name, abstract_class in abstract_class_by_name.items()
        if isinstance(value, abstract_class)
    }


def check_argument_class_or_unwrap_run(
    key: str, value: Any, annotation: str, known_class_names: Collection[str]
) -> Any:
    """Check an argument against its annotation, and return the argument.

    A user may give a Run where a function takes the result alone: ``value.result`` is then
    returned. Any other argument is returned unchanged. Classes are compared by name: no module is
    imported for the check.

    Parameters
    ----------
    key, value
        Name and value of the argument.
    annotation : str
        Annotation: class names with " | " between them.
    known_class_names : collection of str
        Class names that can be compared, beside those in
        :data:`ARGUMENT_DESCRIPTION_BY_CLASS_NAME`. If the annotation has any further class, or is
        ``str`` alone, nothing is checked.

    Raises
    ------
    InputError
        The argument is of no class in the annotation.
    """
    annotation_class_names = list(
        dict.fromkeys(
            annotation_part.partition("[")[0] for annotation_part in annotation.split(" | ")
        )
    )
    value_class_names = _class_names_of(value)
    comparable_class_names = {*known_class_names, *ARGUMENT_DESCRIPTION_BY_CLASS_NAME}
    is_annotation_comparable = {"str"} != {*annotation_class_names} <= comparable_class_names
    if is_annotation_comparable and value_class_names.isdisjoint(annotation_class_names):
        if "Run" in value_class_names and not _class_names_of(value.result).isdisjoint(
            annotation_class_names
        ):
            return value.result
        is_plain_value = isinstance(value, str | int | float | None)
        class_descriptions = [
            ARGUMENT_DESCRIPTION_BY_CLASS_NAME.get(class_name)
            or f"a{'n' * (class_name[0] in 'AEIO')} {class_name}"
            for class_name in annotation_class_names
        ]
        requirement_text = " or ".join(class_descriptions)
        if is_plain_value:
            raise InputError(key, value, requirement_text)
        class_name = type(value).__name__
        raise InputError(
            key, class_name, f"{requirement_text}; this argument is of class {class_name}"
        )
    return value


def keep_old_attribute_names(**new_name_by_old_name: str) -> Callable[[type[Class]], type[Class]]:
    """Return a class decorator that keeps old names of attributes as properties.

    ``new_name_by_old_name`` has old names as keywords, and new names as values. Reading an old name
    warns with a FutureWarning. An old name stays for one version.
    """

    def add_old_names(changed_class: type[Class]) -> type[Class]:
        for old_name, new_name in new_name_by_old_name.items():
            read_attribute = functools.partial(_read_by_old_name, old_name, new_name)
            setattr(changed_class, old_name, property(read_attribute, doc=f"Old name: {new_name}."))
        return changed_class

    return add_old_names


def _read_by_old_name(old_name: str, new_name: str, instance: object) -> Any:
    """Return an attribute by its new name, and warn that the old name will be refused.

    ``instance`` is the object that has the attribute.
    """
    class_name = type(instance).__name__
    message = (
        f"{class_name}.{old_name} is {class_name}.{new_name} now; the old name will be refused"
    )
    warnings.warn(message, FutureWarning, stacklevel=2)
    return getattr(instance, new_name)


def check_calls(
    function: Function,
    find_scene_keys: Callable[[str], Sequence[str]] | None = None,
    known_class_names: Collection[str] = (),
) -> Function:
    """Decorate a function to check arguments, and to suggest corrections in errors.

    If an argument is missing or unknown, the TypeError suggests another argument, a key of the
    scene, or another function. A ``comm`` that is no communicator raises an InputError.

    Parameters
    ----------
    function : callable
        Function to decorate.
    find_scene_keys : callable, optional
        Function to return scene keys similar to an unknown argument's name.
    known_class_names : collection of str
        Class names for :func:`check_argument_class_or_unwrap_run`, which checks each argument.

    Returns
    -------
    callable
        Function with the same arguments and result, and with the checks.
    """
    from inspect import signature as signature_of  # takes a while: not for the program

    signature = signature_of(function)
    takes_any_keyword = any(
        parameter.kind is parameter.VAR_KEYWORD for parameter in signature.parameters.values()
    )
    parameter_names = [
        name
        for name, parameter in signature.parameters.items()
        if parameter.kind is not parameter.VAR_KEYWORD and name not in ("self", "cls")
    ]
    keyword_only_names = {
        name
        for name, parameter in signature.parameters.items()
        if parameter.kind is parameter.KEYWORD_ONLY
    }
    argument_texts = [
        f"{name}=..." if name in keyword_only_names else name for name in parameter_names
    ]

    @functools.wraps(function)
    def call(*args: Any, **options: Any) -> Any:
        try:
            bound_arguments = signature.bind(*args, **options)
        except TypeError as error:
            name, reason_text = function.__name__, str(error)
            unknown_keyword = next(
                (parameter for parameter in options if parameter not in signature.parameters), None
            )
            if reason_text == "too many positional arguments":
                suggestions = []
            elif unknown_keyword is None or takes_any_keyword:
                suggestions = [
                    call_text
                    for call_text in find_calls_by_synonyms(name)
                    if f"fc.{name}(" not in call_text
                ]
            else:
                reason_text = f"got an unexpected keyword argument {unknown_keyword!r}"
                suggestions = find_similar_or_longer_names(unknown_keyword, parameter_names)
                if not suggestions and find_scene_keys is not None:
                    suggestions = [
                        f'scene.replace({{"{key}": ...}})'
                        for key in find_scene_keys(unknown_keyword)
                    ]
            question_text = (
                f"{did_you_mean_text(suggestions)}its arguments are {', '.join(argument_texts)}"
            )
            raise TypeError(f"{name}() {reason_text}; {question_text}") from None
        arguments = bound_arguments.arguments
        if "comm" in arguments:
            from fenics_crack.basics.ranks import check_communicator

            check_communicator(arguments["comm"])
        for name, value in arguments.items():
            annotation = str(signature.parameters[name].annotation)
            arguments[name] = check_argument_class_or_unwrap_run(
                name, value, annotation, known_class_names
            )
        return function(*bound_arguments.args, **bound_arguments.kwargs)

    return cast(Function, call)


# --- numbers --------------------------------------------------------------------------------------


def convert_to_unit_or_none(text: str, unit: str) -> float | None:
    """Convert a text with a number, and perhaps a unit, to a given unit.

    The number may have a decimal comma; without a unit, it is in ``unit``.

    Returns
    -------
    float or None
        Number in ``unit``; None if the text is no number, or has an unknown unit.
    """
    number_match = NUMBER_WITH_UNIT_PATTERN.fullmatch(
        text.strip()[:100].translate(UNIT_SPELLING_TABLE)
    )
    try:
        number = float(number_match[1].replace(",", ".")) if number_match else None
    except ValueError:
        return None
    if number_match is None or number is None:
        return None
    given_unit = re.sub(r"([a-z])([23])\b", r"\1^\2", (number_match[2] or unit).strip())
    if given_unit == unit:
        return number
    unit_factor = FACTORS_FROM_OTHER_UNITS_BY_UNIT.get(unit, {}).get(given_unit)
    if unit_factor is None and unit and given_unit.endswith(unit):
        unit_factor = FACTOR_BY_UNIT_PREFIX.get(given_unit.removesuffix(unit))
    if unit_factor is None or not math.isfinite(number * unit_factor):
        return None
    return float(f"{number * unit_factor:.12g}")  # no 0.30000000000000004


def yield_candidate_values(value: object, unit: str) -> Iterator[object]:
    """Yield values that the user probably meant by a wrong value for a scene's key.

    Used to suggest a correction. A text yields, in turn:

    - its number, a float in ``unit``; None if the text is no number,
    - the same number as int, if it is whole,
    - a list of the numbers between its commas; None for entries that are no numbers.

    A list yields a list in which texts are converted in the same way.
    """
    if isinstance(value, str):
        number = convert_to_unit_or_none(value, unit)
        yield number
        if number is not None and number.is_integer():
            yield int(number)
        value = value.strip("[] ").split(",")
    if isinstance(value, list | tuple):
        yield [
            convert_to_unit_or_none(entry, unit) if isinstance(entry, str) else entry
            for entry in value
        ]


def format_scene_value(value: object) -> str:
    """Return a value as text for a scene.

    A float is shortened to six digits if this is exact: "2.1e+11".
    """
    short_number_text = f"{value:g}" if isinstance(value, float) else ""
    return (
        short_number_text
        if short_number_text and float(short_number_text) == value
        else repr(value)
    )
