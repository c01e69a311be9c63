"""A pipeline file with every key in it, each explained by the model that it is checked against."""

import ast
import inspect
import re
import textwrap
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import tomli_w
from pydantic import BaseModel

from pcnav.config.pipeline_file import Pipeline
from pcnav.files.toml_file import tables_of

_WIDTH = 96
_BOUNDS = {
    **dict.fromkeys(("exclusiveMinimum", "gt"), "above {:,}"),
    **dict.fromkeys(("minimum", "ge"), "{:,} or more"),
    **dict.fromkeys(("exclusiveMaximum", "lt"), "below {:,}"),
    **dict.fromkeys(("maximum", "le"), "{:,} or less"),
}
"""As a schema calls them, and as pydantic does behind a check of its own."""
_HEAD = """\
# A pipeline file: every key, at {values}.
# Keys that are commented out have no value; a file of your own needs no more than what differs.

"""


@dataclass(frozen=True)
class ExplainedKey:
    """A key of a table."""

    name: str
    value: str | None
    """As TOML has it; None where there is none."""
    allowed: str
    """Which values it takes, as far as that is a list or a bound."""
    explained: str
    """What it means; a file has no None, so a key without a value is absent."""


@dataclass(frozen=True)
class ExplainedTable:
    """A table of a pipeline file; the keys before the first table are one without a name."""

    name: str
    explained: str
    keys: tuple[ExplainedKey, ...]
    is_stated: bool = True
    """Whether it is there: some are only where they are asked for."""


def explained_tables(pipeline: Pipeline | None = None) -> Iterator[ExplainedTable]:
    """All tables of a pipeline, of one with the defaults unless told, from its models."""
    pipeline = pipeline or Pipeline()
    tables, schema = tables_of(Pipeline), Pipeline.model_json_schema()
    plain = {name: getattr(pipeline, name) for name in Pipeline.model_fields if name not in tables}
    yield ExplainedTable("", "", tuple(_keys(Pipeline, plain, schema["properties"], schema)))
    for name, model in tables.items():
        value = getattr(pipeline, name)
        values = {key: getattr(value, key, None) for key in model.model_fields}
        values |= (value.model_extra or {}) if value is not None else {}
        keys = _keys(model, values, schema["$defs"][model.__name__]["properties"], schema)
        text = _without_none(inspect.getdoc(model) or "")
        yield ExplainedTable(name, text, tuple(keys), value is not None)


def commented_toml(
    pipeline: Pipeline, table: str | None = None, values: str = "its default"
) -> str:
    """A pipeline as TOML with all its keys and what they mean; or one of its tables.

    `read_pipeline` reads it back as it is. Raises ``KeyError`` for a table that there is not.
    """
    tables = {each.name: each for each in explained_tables(pipeline)}
    if table is not None:
        return "\n".join(_lines(tables[table])) + "\n"
    written = ("\n".join(_lines(each)) + "\n" for each in tables.values())
    return _HEAD.format(values=values) + "\n".join(written)


def _lines(table: ExplainedTable) -> Iterator[str]:
    """The lines of a table; all of one that is not there are comments."""
    yield from _comment(table.explained)
    if table.name:
        yield f"{'' if table.is_stated else '# '}[{table.name}]"
    for key in table.keys:
        yield from _comment(key.explained)
        if key.value is None:
            yield f"# {key.name} =  # {key.allowed or 'text'}"
        else:
            yield f"{key.name} = {key.value}{f'  # {key.allowed}' if key.allowed else ''}"


def _keys(
    model: type[BaseModel],
    values: Mapping[str, Any],
    properties: Mapping[str, Any],
    schema: Mapping[str, Any],
) -> Iterator[ExplainedKey]:
    said = _explained(model)
    for name, value in values.items():
        allowed = _allowed(properties.get(name, {}), schema)
        stated = None if value is None else _inline(value)
        yield ExplainedKey(name, stated, allowed, _without_none(said.get(name, "")))


def _without_none(text: str) -> str:
    return re.sub(r"\bNone\b", "no value", text)


def _inline(value: Any) -> str:
    """A value as TOML has it, on one line."""
    if isinstance(value, tuple):
        return f"[{', '.join(map(_inline, value))}]"
    plain = str(value) if isinstance(value, str) else value
    return tomli_w.dumps({"key": plain}).removeprefix("key = ").rstrip()


def _comment(text: str) -> Iterator[str]:
    for paragraph in text.split("\n\n"):
        for line in textwrap.wrap(" ".join(paragraph.split()), _WIDTH):
            yield f"# {line}"


def _allowed(found: Mapping[str, Any], schema: Mapping[str, Any]) -> str:
    """Which values a key takes, as far as that is a list or a bound."""
    for each in (found, *found.get("anyOf", ()), *found.get("allOf", ())):
        name = each.get("$ref", "").rpartition("/")[2]
        resolved = schema["$defs"][name] if name else each
        if "enum" in resolved:
            return " | ".join(f'"{choice}"' for choice in resolved["enum"])
        words = [text.format(each[key]) for key, text in _BOUNDS.items() if key in each]
        if words:
            return ", ".join(words)
        if "prefixItems" in each and "anyOf" in found:
            return f"{len(each['prefixItems'])} numbers"
    return ""


@lru_cache
def _explained(model: type[BaseModel]) -> Mapping[str, str]:
    """The texts below the fields of a model, its bases' among them."""
    texts: dict[str, str] = {}
    for each in reversed(model.__mro__):
        if not (issubclass(each, BaseModel) and each.__module__.startswith("pcnav.")):
            continue
        (tree,) = ast.parse(textwrap.dedent(inspect.getsource(each))).body
        assert isinstance(tree, ast.ClassDef), "it is a class"
        for field, text in zip(tree.body, tree.body[1:], strict=False):
            if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name):
                match text:
                    case ast.Expr(ast.Constant(str() as said)):
                        texts[field.target.id] = said
    return texts
