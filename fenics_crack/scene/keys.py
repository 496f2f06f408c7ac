"""The tables and keys of a scene, and changes of values by full key."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, get_args, get_origin, get_type_hints

from fenics_crack.basics.errors import InputError
from fenics_crack.basics.suggestions import (
    did_you_mean_text,
    find_similar_names,
    find_similar_or_longer_names,
    keep_old_attribute_names,
)
from fenics_crack.scene import result_tables
from fenics_crack.scene import tables as kinds
from fenics_crack.scene.fields import (
    Axis,
    OutputPoint,
    Table,
    find_full_keys,
    use_table_name_in_errors,
)

RESULT_SETTINGS_TABLE_NAMES = (
    "curve",
    "integration",
    "sweep",
    "growth",
    "identify",
    "tip_timing",
    "output",
)
"""Tables that only choose results and do not change the structure or its load."""


@keep_old_attribute_names(highest_order="highest_load_harmonic")
@dataclass(frozen=True, repr=False)
class SceneTables:
    """Tables of a scene, with derived properties.

    An omitted table is None or has default values. If the scene has the table ``structure``, the
    tables of a plate are None.
    """

    geometry: kinds.Geometry = None  # type: ignore[assignment]
    material: kinds.Material = None  # type: ignore[assignment]
    damping: kinds.Damping = None  # type: ignore[assignment]
    excitation: kinds.Excitation = None  # type: ignore[assignment]
    mesh: kinds.Mesh = None  # type: ignore[assignment]
    contact: kinds.Contact | None = None
    crack: kinds.Crack | None = None
    cracks: tuple[kinds.Crack, ...] = ()
    """Cracks in addition to ``crack``."""
    loads: tuple[kinds.Load, ...] = ()
    """Loads in addition to the excitation's force."""
    base: kinds.Base | None = None
    rotation: kinds.Rotation | None = None
    disk: kinds.Disk | None = None
    structure: kinds.Structure | None = None
    harmonic_balance: kinds.HarmonicBalance = field(default_factory=kinds.HarmonicBalance)
    reduction: kinds.Reduction | None = None
    curve: result_tables.Curve | None = None
    integration: result_tables.Integration | None = None
    sweep: result_tables.Sweep | None = None
    growth: result_tables.Growth | None = None
    identify: result_tables.Identify | None = None
    tip_timing: result_tables.TipTiming | None = None
    output: result_tables.Output | None = None

    @property
    def table_by_name(self) -> dict[str, Table]:
        """Tables that the scene has, by the names in error messages: "contact", "cracks.1"."""
        table_by_name: dict[str, Table] = {}
        for table_name, table_or_list in vars(self).items():
            if table_name in LIST_TABLE_NAMES:
                table_by_name |= {
                    f"{table_name}.{list_position}": table
                    for list_position, table in enumerate(table_or_list, 1)
                }
            elif table_or_list is not None:
                table_by_name[table_name] = table_or_list
        return table_by_name

    @property
    def crack_by_name(self) -> dict[str, kinds.Crack]:
        """Cracks by name: "crack", "cracks.1", "cracks.2"."""
        return {
            name: table
            for name, table in self.table_by_name.items()
            if isinstance(table, kinds.Crack)
        }

    @property
    def dimension(self) -> int:
        """Number of space dimensions: 2 or 3.

        A plate has 2, a solid 3. Given matrices have 3 with another program's model
        (``structure.model``), otherwise 2.
        """
        if self.structure is not None:
            return 2 if self.structure.model is None else 3
        return 2 if self.geometry is None else self.geometry.dimension

    @property
    def has_graded_lengths(self) -> bool:
        """True if element lengths follow from the distances to crack tips and corners.

        This holds for a solid, and for a bladed disk's sector with ``mesh.layout = "graded"``.
        """
        return self.dimension == 3 or (self.disk is not None and self.mesh.layout == "graded")

    @property
    def has_friction(self) -> bool:
        """True if ``contact.friction`` is above 0, in the scene or in any case of the sweep."""
        contact_has_friction = self.contact is not None and bool(self.contact.friction)
        return contact_has_friction or any(self.swept_values_by_key.get("contact.friction", ()))

    @property
    def highest_load_harmonic(self) -> int:
        """Highest multiple of the excitation frequency in any load."""
        periodic_loads: list[kinds.PeriodicLoad | None] = [self.excitation, *self.loads, self.base]
        return max(
            periodic_load.highest_load_harmonic
            for periodic_load in periodic_loads
            if periodic_load is not None
        )

    @property
    def has_other_loads(self) -> bool:
        """True if any load beside the force at ``excitation.point`` may act.

        These are [[loads]], [base], and loads in files of [structure].
        """
        return bool(self.loads) or self.base is not None or self.structure is not None

    @property
    def speed(self) -> float:
        """Rotor speed [rad/s]; 0 without [rotation]."""
        return 0.0 if self.rotation is None else self.rotation.speed

    @property
    def output_points(self) -> tuple[OutputPoint, ...]:
        """Points in ``[output.points]``; empty without such points."""
        return () if self.output is None else self.output.points

    @property
    def swept_values_by_key(self) -> dict[str, tuple[Any, ...]]:
        """Values on each axis in the sweep, by full key; empty without a sweep."""
        return {} if self.sweep is None else {axis.key: axis.values for axis in self.sweep.over}


def missing_table_error(table_name: str, circumstance: str = "") -> InputError:
    """Return the error for a missing table, which names the table's required keys.

    ``circumstance`` is text appended to the requirement: ", which this command needs".
    """
    keys_text = ", ".join(TABLE_CLASS_BY_NAME[table_name].required_keys())
    required_table_text = f"given: a table [{table_name}]"
    if keys_text:
        required_table_text += f" with {keys_text}"
    elif not circumstance:
        required_table_text += ", as fenics-crack new FILE writes it"
    return InputError(table_name, None, required_table_text + circumstance)


def known_keys() -> list[str]:
    """Return every full key that a scene may have.

    For a list of tables, the keys of the first table are returned: "cracks.1.length".
    """
    named_table_classes = [
        (f"{table_name}.1" if table_name in LIST_TABLE_NAMES else table_name, table_class)
        for table_name, table_class in TABLE_CLASS_BY_NAME.items()
    ]
    return [
        f"{table_name}.{key_in_table}"
        for table_name, table_class in named_table_classes
        for key_in_table in table_class.field_by_key()
    ]


def unit_of_key(full_key: str) -> str:
    """Return the unit for a full key, "cracks.1.length"; empty without a unit."""
    table_name, _, key_in_table = _split_key(full_key)
    field_by_key = (
        TABLE_CLASS_BY_NAME[table_name].field_by_key() if table_name in TABLE_CLASS_BY_NAME else {}
    )
    return str(field_by_key[key_in_table].metadata["unit"]) if key_in_table in field_by_key else ""


def _split_key(full_key: str) -> tuple[str, int | None, str]:
    """Split a full key: "cracks.1.length" gives "cracks", 1, "length".

    The position is None for a table that is not in a list.
    """
    table_name, _, key_in_table = full_key.partition(".")
    position_text, _, key_after_position = key_in_table.partition(".")
    if (
        table_name in LIST_TABLE_NAMES
        and position_text.isdecimal()
        and 0 < len(position_text) < 10
        and int(position_text) > 0
    ):
        return table_name, int(position_text), key_after_position
    return table_name, None, key_in_table


def make_tables(raw_table_by_name: Mapping[str, object]) -> dict[str, Any]:
    """Return the tables of a scene by name, made from raw values.

    A list of tables becomes a tuple. Raises InputError for an unknown table.
    """
    for table_name, raw_table in raw_table_by_name.items():
        if table_name not in TABLE_CLASS_BY_NAME:
            raise InputError(table_name, raw_table, _unknown_table_text(table_name))
    return {
        table_name: _make_table_or_tuple(table_name, raw_table)
        for table_name, raw_table in raw_table_by_name.items()
    }


def _make_table_or_tuple(table_name: str, raw_tables: object) -> Any:
    """Return a table made from raw values, or a tuple of tables for a list.

    Raw values are mappings as read from TOML. A table that is an object already stays unchanged.
    """
    table_class = TABLE_CLASS_BY_NAME[table_name]
    if table_name not in LIST_TABLE_NAMES:
        return (
            raw_tables
            if isinstance(raw_tables, table_class)
            else table_class.from_mapping(raw_tables)
        )
    if not isinstance(raw_tables, list | tuple):
        raise InputError(table_name, raw_tables, f"a list of tables headed [[{table_name}]]")
    made_tables = []
    for list_position, raw_table in enumerate(raw_tables, 1):
        with use_table_name_in_errors(f"{table_name}.{list_position}"):
            made_tables.append(
                raw_table
                if isinstance(raw_table, table_class)
                else table_class.from_mapping(raw_table)
            )
    return tuple(made_tables)


def _split_changed_key(full_key: str, value: object) -> tuple[str, int | None, str]:
    """Split the full key of a change into table name, position in a list, and key.

    The position counts from 1; None for a table outside lists. The key is empty if the change
    removes the whole table, by ``value`` None. Raises InputError for an unknown key, or if the
    table cannot be removed.
    """
    table_name, list_position, key_in_table = _split_key(full_key)
    table_class = TABLE_CLASS_BY_NAME.get(table_name)
    if table_class is None:
        raise InputError(full_key, value, _unknown_table_text(full_key))
    if not key_in_table and table_class.KEY_OF_BARE_VALUE is not None and isinstance(value, str):
        return table_name, None, table_class.KEY_OF_BARE_VALUE
    if not key_in_table:
        if (
            value is not None
            or list_position is not None
            or table_name not in (*OPTIONAL_TABLE_NAMES, *LIST_TABLE_NAMES)
        ):
            removable_table_names = ", ".join((*OPTIONAL_TABLE_NAMES, *LIST_TABLE_NAMES))
            first_key = next(key for key in known_keys() if key.startswith(f"{table_name}."))
            raise InputError(
                full_key,
                "none" if value is None else value,
                f"changed key by key, as {first_key}=...; only these tables can be "
                f"removed, by TABLE=none (in Python None): {removable_table_names}",
            )
    elif (list_position is None) == (table_name in LIST_TABLE_NAMES):
        known_keys_text = ", ".join(
            f"{table_name}.1.{subkey}" for subkey in table_class.field_by_key()
        )
        raise InputError(full_key, value, f"left out; known keys: {known_keys_text}")
    elif key_in_table not in table_class.field_by_key():
        key_before_subkey, _, subkey = key_in_table.replace('"', "").partition(".")
        if key_before_subkey in table_class.field_by_key() and subkey:
            raise InputError(
                full_key,
                value,
                f'changed as a whole: {table_name}.{key_before_subkey}={{"{subkey}"=...}}',
            )
        raise InputError(full_key, value, table_class.unknown_key_text(key_in_table))
    return table_name, list_position, key_in_table


def with_changed_keys(
    table_by_name: Mapping[str, Any], value_by_full_key: Mapping[str, object]
) -> dict[str, Any]:
    """Return tables by name, with values changed by full key.

    A changed table becomes a mapping from key to value. A changed list becomes a tuple of such
    mappings. The values are not checked yet.
    """
    changed_tables = dict(table_by_name)
    changes_by_table: dict[tuple[str, int], dict[str, object]] = {}
    for full_key, raw_value in value_by_full_key.items():
        table_name, list_position, key_in_table = _split_changed_key(str(full_key), raw_value)
        if key_in_table:
            changes_by_table.setdefault((table_name, list_position or 0), {})[key_in_table] = (
                raw_value
            )
        else:
            changed_tables.pop(table_name, None)
    for (table_name, list_position), table_changes in sorted(
        changes_by_table.items(), key=lambda changes_item: changes_item[0][1]
    ):
        if list_position:
            changed_tables[table_name] = _merge_list_changes(
                table_name, changed_tables.get(table_name, ()), list_position, table_changes
            )
        else:
            changed_tables[table_name] = _merge_table_changes(
                table_name, changed_tables.get(table_name), table_changes
            )
    return changed_tables


def _merge_table_changes(table_name: str, table: Any, value_by_key: dict[str, object]) -> Any:
    """Return a table as a mapping, with changed values.

    If a changed quantity also has a key in another unit, the other key becomes None.

    Parameters
    ----------
    table_name : str
        Name of the table.
    table : Table, mapping, str or None
        Present table. A str is short for a table with one key: "off" for ``method = "off"`` in
        [reduction]. An object of any different type is returned unchanged, and refused when the
        table is made.
    value_by_key : dict
        Changed values by key.
    """
    table_class = TABLE_CLASS_BY_NAME[table_name]
    if isinstance(table, table_class):
        table = {
            key: getattr(table, key)
            for key in table_class.field_by_key().keys() - table.derived_keys
        }
    if table_class.KEY_OF_BARE_VALUE is not None and isinstance(table, str):
        table = {table_class.KEY_OF_BARE_VALUE: table}
    if table is None:
        return value_by_key
    if not isinstance(table, Mapping):  # refused when it is made
        return table
    return {**table, **table_class.make_changes_with_twins_removed(value_by_key, table)}


def _merge_list_changes(
    table_name: str, tables: Any, list_position: int, value_by_key: dict[str, object]
) -> tuple[Any, ...]:
    """Return a list of tables with one table changed or appended.

    Parameters
    ----------
    table_name : str
        Name of the list, such as "cracks".
    tables : list or tuple
        Present tables; InputError for other types.
    list_position : int
        Position of the changed table, from 1. The number of tables plus 1 appends a table;
        InputError for a larger position.
    value_by_key : dict
        Changed values by key.
    """
    if not isinstance(tables, list | tuple):
        raise InputError(table_name, tables, f"a list of tables headed [[{table_name}]]")
    if list_position > len(tables) + 1:
        key, value = next(iter(value_by_key.items()))
        raise InputError(
            f"{table_name}.{list_position}.{key}",
            value,
            f"in {table_name}.{len(tables) + 1}, the next number, as the scene has "
            f"{len(tables)} tables [[{table_name}]]",
        )
    current_table = tables[list_position - 1] if list_position <= len(tables) else None
    with use_table_name_in_errors(f"{table_name}.{list_position}"):
        return (
            *tables[: list_position - 1],
            _merge_table_changes(table_name, current_table, value_by_key),
            *tables[list_position:],
        )


def _suggest_keys(misspelt_name: str) -> list[str]:
    """Return known keys and tables similar to a misspelt name; empty without any."""
    table_name, _, key_in_table = misspelt_name.partition(".")
    if table_name in TABLE_CLASS_BY_NAME:
        return TABLE_CLASS_BY_NAME[table_name].suggest_keys(key_in_table) if key_in_table else []
    if key_in_table:
        all_keys = {
            table_class.full_key_in_first_table(key_in_table)
            for table_class in TABLE_CLASS_BY_NAME.values()
            for key_in_table in table_class.field_by_key()
        }
        return find_similar_names(misspelt_name, all_keys, 0.8) or sorted(
            full_key for full_key in all_keys if full_key.endswith(f".{key_in_table}")
        )
    return list(
        dict.fromkeys(find_full_keys(table_name, TABLE_CLASS_BY_NAME.values()))
    ) or find_similar_names(table_name, TABLE_CLASS_BY_NAME)


def suggest_full_keys(misspelt_name: str) -> list[str]:
    """Return full keys similar to a misspelt name, such as "crack.length" for "crack.lenght".

    The name may also be a key without its table. Empty if no key is similar.
    """
    full_key_by_short_key = {key.rpartition(".")[2]: key for key in reversed(known_keys())}
    suggested_full_keys = _suggest_keys(misspelt_name) or [
        full_key_by_short_key[key]
        for key in find_similar_or_longer_names(misspelt_name, full_key_by_short_key)
    ]
    return suggested_full_keys or find_similar_or_longer_names(misspelt_name, known_keys())


def _unknown_table_text(table_name: str) -> str:
    """Return the end of the error about an unknown table.

    The text asks to leave out the table. Then follow similar names, and the names of all tables.
    """
    suggestion_text = did_you_mean_text(_suggest_keys(table_name))
    return f"left out; {suggestion_text}known tables: {', '.join(TABLE_CLASS_BY_NAME)}"


def check_and_convert_axes(
    tables: SceneTables, axes_key: str, axes: tuple[Axis, ...]
) -> tuple[Axis, ...]:
    """Return the axes of a sweep or an identification, checked and with converted values.

    Each value gets the type that the scene stores for the key. Raises InputError for a key that is
    unknown, repeated or not sweepable, and for wrong or equal values. Combinations of values are
    checked later, in each case.

    Parameters
    ----------
    tables : SceneTables
        Tables of the scene.
    axes_key : str
        Key of the axes, for errors: "sweep.over".
    axes : tuple of Axis
        Axes as read from the scene.
    """
    checked_axes, seen_keys = [], set()
    for axis in axes:
        table_name, list_position, key_in_table = _split_key(axis.key)
        table_exists = list_position is None or list_position <= len(getattr(tables, table_name))
        is_sweepable_key = (
            table_name in _SWEEPABLE_TABLE_NAMES
            and key_in_table in TABLE_CLASS_BY_NAME[table_name].field_by_key()
        )
        if not (is_sweepable_key and table_exists) or axis.key in seen_keys:
            tables_text = ", ".join(_SWEEPABLE_TABLE_NAMES)
            suggested_keys = [] if axis.key in seen_keys else _suggest_keys(axis.key)
            suggested_keys = [
                key for key in suggested_keys if _split_key(key)[0] in _SWEEPABLE_TABLE_NAMES
            ]
            raise InputError(
                axes_key,
                axis.key,
                "a key of the scene with its table, as 'crack.length', given once; "
                f"the tables are {tables_text}; {did_you_mean_text(suggested_keys)}".rstrip("; "),
            )
        seen_keys.add(axis.key)
        table_class = TABLE_CLASS_BY_NAME[table_name]
        table_name_in_errors = axis.key.removesuffix(f".{key_in_table}")
        twin_key = f"{table_name_in_errors}.{table_class.twin_key_by_key().get(key_in_table)}"
        if twin_key in seen_keys:
            raise InputError(axes_key, axis.key, f"left out with {twin_key}: give one of the two")
        with use_table_name_in_errors(table_name_in_errors):
            axis_values = tuple(
                table_class.convert_value(key_in_table, axis_value) for axis_value in axis.values
            )
        if len(set(axis_values)) != len(axis_values) or not axis_values:
            raise InputError(
                f'{axes_key}."{axis.key}"', axis_values, "one or more different values"
            )
        checked_axes.append(Axis(axis.key, axis_values))
    return tuple(checked_axes)


_TABLE_NAMES_AND_TYPE_HINTS = get_type_hints(SceneTables).items()
TABLE_CLASS_BY_NAME: dict[str, type[Table]] = {
    name: (get_args(hint) or (hint,))[0] for name, hint in _TABLE_NAMES_AND_TYPE_HINTS
}
LIST_TABLE_NAMES = tuple(
    name for name, hint in _TABLE_NAMES_AND_TYPE_HINTS if get_origin(hint) is tuple
)
OPTIONAL_TABLE_NAMES = tuple(
    name for name, hint in _TABLE_NAMES_AND_TYPE_HINTS if type(None) in get_args(hint)
)
PATH_KEYS = tuple(
    kind.full_key(key)
    for kind in TABLE_CLASS_BY_NAME.values()
    for key, item in kind.field_by_key().items()
    if "path" in item.metadata
)
"""Full keys whose value is a file's path."""
AXES_TABLE_KEY_PAIRS = ("sweep", "over"), ("identify", "unknown")
"""(table, key) pairs whose value is a tuple of :class:`Axis`."""
KEYS_THAT_MAY_CONTAIN_PATHS = (
    *PATH_KEYS,
    *(f"{name}.{key}" for name, key in AXES_TABLE_KEY_PAIRS),
    "identify.meshes",
)
"""Full keys whose values may contain paths: single paths, axes and mesh files."""
_SWEEPABLE_TABLE_NAMES = tuple(
    name for name in TABLE_CLASS_BY_NAME if name not in RESULT_SETTINGS_TABLE_NAMES
)
