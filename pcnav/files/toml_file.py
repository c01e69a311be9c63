"""TOML files, read within bounds and checked against a pydantic model."""

import re
import tomllib
from difflib import get_close_matches
from pathlib import Path
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ValidationError

from pcnav.core.errors import InputError
from pcnav.files.regular_file import require_regular

Model = TypeVar("Model", bound=BaseModel)

_MAX_BYTES = 1_000_000
"""Of a file of settings; points and hypotheses by the thousand fit."""
_MAX_DEPTH = 32
"""Of brackets, and of keys between dots: the parser's time and memory grow as its square."""
_MAX_SHOWN = 80
"""Characters of a wrong value that a message repeats."""
_DOTTED_KEY = re.compile(rf"(?:[\w\"'-]+\s*\.\s*){{{_MAX_DEPTH}}}")
_COMMENT = re.compile(r"#[^\n]*")


def read_toml(path: Path) -> dict[str, Any]:
    """The tables of a TOML file.

    Raises `InputError` for a file that cannot be read, is no TOML, or is larger or nested deeper
    than any file of settings is.
    """
    try:
        require_regular(path, _MAX_BYTES, "a readable TOML file")
        text = path.read_text(encoding="utf-8")
        if _is_deep(text):
            raise InputError(path, "file", f"expected TOML nested at most {_MAX_DEPTH} deep")
        return tomllib.loads(text)
    except InputError:
        raise
    except OSError as error:
        expected = f"expected a readable TOML file ({error.strerror})"
        raise InputError(path, "file", expected) from error
    except ValueError as error:
        # Invalid TOML and text are of this kind, and integers of thousands of digits.
        raise InputError(path, "file", f"expected valid TOML ({error})") from error


def read_toml_model(path: Path, model: type[Model]) -> Model:
    """A TOML file checked against a pydantic model. Raises `InputError` in one line."""
    return checked(path, model, read_toml(path))


def checked(path: Path | str, model: type[Model], found: object, within: str = "") -> Model:
    """What a file says, checked against a model. Raises `InputError` in one line.

    ``within`` is the key in the file that the model is of.
    """
    try:
        return model.model_validate(found)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        field = ".".join(str(part) for part in (within, *first["loc"]) if part != "") or "file"
        expected = first["msg"].removeprefix("Value error, ")
        if first["type"] == "extra_forbidden":
            expected = f"unknown key; {_meant(model, first['loc'])}"
        elif first["type"] == "missing":
            expected = "missing; expected a value"
        elif first["type"] != "value_error":
            shown = repr(first.get("input"))
            cut = shown if len(shown) <= _MAX_SHOWN else f"{shown[:_MAX_SHOWN]}..."
            expected = f"{expected}, got {cut}"
        raise InputError(path, field, expected) from error


def tables_of(model: type[BaseModel]) -> dict[str, type[BaseModel]]:
    """The keys of a model that hold tables, and the models of these."""
    found = {name: _model_in(field.annotation) for name, field in model.model_fields.items()}
    return {name: table for name, table in found.items() if table is not None}


def _meant(model: type[BaseModel], where: tuple[int | str, ...]) -> str:
    """What a key that is unknown may have been meant for."""
    table, key = model, str(where[-1])
    for part in where[:-1]:
        table = tables_of(table).get(str(part), table)
    homes = [name for name, each in tables_of(model).items() if key in each.model_fields]
    if homes:
        return f"expected in {' or '.join(f'[{home}]' for home in homes)}"
    near = get_close_matches(key, table.model_fields, n=1)
    if near:
        return f"did you mean {near[0]}?"
    return f"expected one of {', '.join(table.model_fields)}"


def _model_in(annotation: object) -> type[BaseModel] | None:
    """The model that a field holds, alone, or None, or in a tuple; None where it holds none."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    inner = (_model_in(argument) for argument in get_args(annotation))
    return next((found for found in inner if found is not None), None)


def _is_deep(text: str) -> bool:
    """Whether brackets or dotted keys go deeper than allowed; what stands in comments is none."""
    content = _COMMENT.sub("", text)
    depth = 0
    for bracket in re.findall(r"[\[\]{}]", content):
        depth = depth + 1 if bracket in "[{" else max(depth - 1, 0)
        if depth > _MAX_DEPTH:
            return True
    return _DOTTED_KEY.search(content) is not None
