"""Strict TOML: a file becomes one frozen struct, or one line that says what is wrong.

Every failure is an :class:`~dftc_rt.errors.InputError` whose ``where`` names the
file and the key path. Unknown keys are errors, and so is ``nan`` anywhere: it would
pass every range check that is written as a comparison.
"""

from __future__ import annotations

import copy
import difflib
import math
import re
import tomllib
import typing
from collections.abc import Iterable
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import tomli_w

from dftc_rt.errors import InputError, MissingFileError

T = TypeVar("T")

_SEGMENT = re.compile(r"([A-Za-z0-9_-]+)((?:\[\d+\])*)")
_UNKNOWN_FIELD = re.compile(r"Object contains unknown field `(?P<key>.*)`$", re.DOTALL)
_MISSING_FIELD = re.compile(r"Object missing required field `(?P<key>.*)`$", re.DOTALL)
_EXPECTED = re.compile(
    r"Expected `(?P<type>[^`]+)`(?:, got `(?P<got>[^`]+)`|(?P<bound> .+))?$", re.DOTALL
)
_STEP = re.compile(r"([^.\[\]]+)(?![^\[]*\])|\[(\d+)\]")
_NOTHING = object()
_WORDS = {
    "array": "a list", "object": "a table", "str": "a string", "int": "an integer",
    "float": "a number", "bool": "true or false", "null": "nothing",
}  # fmt: skip


def read(path: str | Path) -> dict[str, Any]:
    """Read a TOML file into a dictionary.

    Raises:
        MissingFileError: There is no such file.
        InputError: It is not a readable file of valid TOML.
    """
    path = Path(path)
    try:
        text = path.read_bytes().decode("utf-8-sig")  # editors on Windows put a BOM first
    except FileNotFoundError:
        raise MissingFileError(str(path), "no such file", "a TOML file") from None
    except (OSError, ValueError) as error:  # a directory, no permission; not UTF-8, NUL in path
        detail = error.strerror if isinstance(error, OSError) else "not a UTF-8 text file"
        raise InputError(str(path), f"cannot be read: {detail}", "a TOML file") from None
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(str(path), _one_line(error), "valid TOML") from None
    except RecursionError:
        raise InputError(str(path), "nested too deeply", "valid TOML") from None


def load(path: str | Path, type: type[T]) -> T:
    """Read a TOML file and check it against a struct type.

    Raises:
        MissingFileError: There is no such file.
        InputError: The file is no TOML, or is not what ``type`` describes.
    """
    return convert(read(path), type, str(path))


def dumps(struct: msgspec.Struct) -> str:
    """Return a struct as TOML, every default written out and nothing where a value is None."""
    return tomli_w.dumps(_without_none(msgspec.to_builtins(struct)))


def convert(raw: dict[str, Any], type: type[T], where: str) -> T:
    """Check a dictionary, as read from TOML, against a struct type.

    A struct's ``__post_init__`` may raise ``ValueError`` (one line) or ``InputError``
    (its ``where`` is a key path inside that struct); both come out with the full path.

    Raises:
        InputError: Unknown or missing key, wrong type, value out of range, or NaN.
    """
    _refuse_nan(raw, where, "")
    try:
        return msgspec.convert(raw, type)
    except msgspec.ValidationError as error:
        raise _explain(error, raw, type, where) from None


def apply_overrides(raw: dict[str, Any], settings: Iterable[str]) -> dict[str, Any]:
    """Return a copy of ``raw`` with ``a.b=value`` settings applied, in their order.

    The value is TOML; what is no TOML value is taken as a string. Missing tables on the
    way are made (whether they may exist is for :func:`convert` to say); list entries
    must exist.

    Raises:
        InputError: No ``=``, no valid key path, an index beyond the list, or a path that
            leads through something that is neither table nor list.
    """
    result = copy.deepcopy(raw)
    for setting in settings:
        path, equals, text = setting.partition("=")
        where = f"--set {_one_line(setting)}"
        if not equals:
            raise InputError(where, "no '='", "key.path=value")
        _assign(result, _steps(path.strip(), where), parse_value(text.strip()), where)
    return result


def parse_value(text: str) -> Any:
    """Parse one TOML value; what is none is returned as the string it is."""
    try:
        table = tomllib.loads(f"value = {text}")
    except (tomllib.TOMLDecodeError, RecursionError):
        return text
    return table["value"] if set(table) == {"value"} else text


def _without_none(node: Any) -> Any:
    if isinstance(node, dict):
        return {k: _without_none(v) for k, v in node.items() if v is not None}
    if isinstance(node, (list, tuple)):
        return [_without_none(v) for v in node]
    return node


def _steps(path: str, where: str) -> list[str | int]:
    """Split ``fault[0].kind`` into ``["fault", 0, "kind"]``."""
    steps: list[str | int] = []
    for segment in path.split("."):
        match = _SEGMENT.fullmatch(segment)
        if match is None:
            raise InputError(where, f"'{path}' is no key path", "keys such as a.b or fault[0].c")
        steps.append(match[1])
        steps.extend(int(index) for index in re.findall(r"\d+", match[2]))
    return steps


def _assign(root: dict[str, Any], steps: list[str | int], value: Any, where: str) -> None:
    node: Any = root
    seen = ""
    for position, step in enumerate(steps):
        last = position == len(steps) - 1
        if isinstance(step, int):
            if not isinstance(node, list):
                raise InputError(where, f"'{seen}' is no list", "a key path that exists")
            if step >= len(node):
                count = len(node)
                raise InputError(
                    where,
                    f"'{seen}' has no entry {step}",
                    f"an index below {count}" if count else "a list that has entries",
                )
            seen += f"[{step}]"
        else:
            if not isinstance(node, dict):
                raise InputError(where, f"'{seen}' is no table", "a key path that exists")
            seen = f"{seen}.{step}" if seen else step
            if not last and step not in node:
                # A list cannot be made from nothing: its entries would be unset.
                node[step] = [] if isinstance(steps[position + 1], int) else {}
        if last:
            node[step] = value
        else:
            node = node[step]


def _refuse_nan(node: Any, where: str, path: str) -> None:
    if isinstance(node, float) and math.isnan(node):
        raise InputError(f"{where}: {path}", "nan", "a number")
    if isinstance(node, dict):
        for key, value in node.items():
            _refuse_nan(value, where, f"{path}.{key}" if path else str(key))
    elif isinstance(node, list):
        for index, value in enumerate(node):
            _refuse_nan(value, where, f"{path}[{index}]")


def _explain(error: msgspec.ValidationError, raw: Any, type_: Any, where: str) -> InputError:
    text, _, location = str(error).partition(" - at `$")
    # A value of a free table comes without its key, as [...]: the table is all there is.
    path = location.removesuffix("`").removeprefix(".").partition("[...]")[0]
    if isinstance(error.__cause__, InputError):
        cause = error.__cause__
        return InputError(f"{where}: {_join(path, cause.where)}", cause.what, cause.expected)
    value, expected_type = _descend(raw, type_, path)
    if match := _UNKNOWN_FIELD.match(text):
        key = match["key"]
        known = _keys(expected_type, value)
        near = difflib.get_close_matches(key, known, n=1)
        expected = f"'{near[0]}'" if near else ("one of " + ", ".join(known) if known else "")
        return InputError(f"{where}: {_join(path, key)}", "unknown key", expected)
    if match := _MISSING_FIELD.match(text):
        choices = _choices(_field_types(expected_type, value).get(match["key"]))
        expected = "one of " + ", ".join(choices) if choices else "this key"
        return InputError(f"{where}: {_join(path, match['key'])}", "missing", expected)
    full = f"{where}: {path}" if path else where
    match = _EXPECTED.match(text)
    if "[...]" in location or value is _NOTHING:
        if match is None or match["got"] is None:
            return InputError(full, _one_line(text))
        return InputError(full, f"found {_words(match['got'])}", _words(match["type"]))
    found = f"found {_shown(value)}"
    choices = _choices(expected_type)
    if match is not None and not (choices and match["type"] == "str"):
        return InputError(full, found, f"{_words(match['type'])}{match['bound'] or ''}")
    if choices:
        number = " or a number" if _has_number(expected_type) else ""
        return InputError(full, found, "one of " + ", ".join(choices) + number)
    return InputError(full, found if isinstance(value, str) else _one_line(text))


def _join(path: str, key: str) -> str:
    return f"{path}.{key}" if path else key


def _words(types_: str) -> str:
    names = dict.fromkeys(_WORDS.get(name.strip(), name.strip()) for name in types_.split("|"))
    return " or ".join(name for name in names if name != "nothing")


def _shown(value: Any) -> str:
    if isinstance(value, dict | list):
        return _WORDS["object" if isinstance(value, dict) else "array"]
    if isinstance(value, bool):
        return str(value).lower()
    text = f"'{_one_line(value)}'" if isinstance(value, str) else str(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _one_line(text: object) -> str:
    return " ".join(str(text).split())


def _descend(raw: Any, type_: Any, path: str) -> tuple[Any, Any]:
    """Value and type at a key path; a value of ``_NOTHING`` or a type of None: not to be had."""
    for name, index in _STEP.findall(path):
        if name:
            type_ = _field_types(type_, raw).get(name)
            raw = raw.get(name, _NOTHING) if isinstance(raw, dict) else _NOTHING
        else:
            inside = isinstance(raw, list) and int(index) < len(raw)
            raw = raw[int(index)] if inside else _NOTHING
    return raw, type_


def _keys(type_: Any, raw: Any) -> list[str]:
    return list(_field_types(type_, raw))


def _field_types(type_: Any, raw: Any) -> dict[str, Any]:
    """Key -> type of the table that ``raw`` is meant to be.

    Of several tables that a tag tells apart, that is the one whose tag ``raw`` has; the tag
    itself is a choice of their tags.
    """
    structs = _structs_in(type_)
    tags: dict[str, Any] = {s.__struct_config__.tag: s for s in structs}
    tag_field = structs[0].__struct_config__.tag_field if structs else None
    chosen = structs[0] if len(structs) == 1 else None
    types: dict[str, Any] = {}
    if tag_field is not None:
        types[tag_field] = typing.Literal[tuple(tags)]
        tag = raw.get(tag_field) if isinstance(raw, dict) else None
        chosen = tags.get(tag) if isinstance(tag, str) else chosen
    if chosen is not None:
        types |= {field.encode_name: field.type for field in msgspec.structs.fields(chosen)}
    return types


def _structs_in(type_: Any) -> list[Any]:
    """The struct types inside ``X``, ``X | Y | None``, ``tuple[X, ...]`` or ``list[X]``."""
    if isinstance(type_, type) and issubclass(type_, msgspec.Struct):
        return [type_]
    return [struct for arg in typing.get_args(type_) for struct in _structs_in(arg)]


def _choices(type_: Any) -> list[str]:
    """Values that the ``Literal`` parts of a type allow."""
    if typing.get_origin(type_) is typing.Literal:
        return [str(value) for value in typing.get_args(type_)]
    return [choice for arg in typing.get_args(type_) for choice in _choices(arg)]


def _has_number(type_: Any) -> bool:
    return type_ in (int, float) or any(_has_number(arg) for arg in typing.get_args(type_))
