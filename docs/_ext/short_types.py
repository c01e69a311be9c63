"""Signatures and fields as the code writes them: autodoc spells an array's alias out in full."""

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx

_ALIASES = {
    "ndarray[tuple[Any, ...], dtype[float64]]": "FloatArray",
    "ndarray[tuple[Any, ...], dtype[bool]]": "BoolArray",
    "ndarray[tuple[Any, ...], dtype[intp]]": "IntArray",
    "Buffer | _SupportsArray[dtype[Any]] | _NestedSequence[_SupportsArray[dtype[Any]]] | complex"
    " | bytes | str | _NestedSequence[complex | bytes | str]": "ArrayLike",
}


def _shorten(_app: Sphinx, doctree: nodes.document, _name: str) -> None:
    for kind in (addnodes.desc_annotation, addnodes.desc_returns, addnodes.desc_parameter):
        for node in doctree.findall(kind):
            text = short = node.astext()
            for full, alias in _ALIASES.items():
                short = short.replace(full, alias)
            if short != text:
                name, colon, rest = short.partition(":")
                is_named = kind is addnodes.desc_parameter and colon
                first = [addnodes.desc_sig_name("", name)] if is_named else []
                node.children = []
                plain = colon + rest if is_named else short.removeprefix(" -> ")
                node += [*first, nodes.Text(plain)]


def _of_fields(_app: Sphinx, what: str, _name: str, thing: object, *_rest: object) -> object:
    """No signature for a dataclass: it would say its fields twice, on one line."""
    return ("", None) if what == "class" and hasattr(thing, "__dataclass_fields__") else None


def _plain_text(
    _app: Sphinx, what: str, _name: str, _thing: object, _options: object, lines: list[str]
) -> None:
    """Napoleon, which comes next, takes what stands before a colon in the first line of a field's
    text for its type: here that is an empty comment."""
    if what in ("attribute", "data", "property"):
        lines[:0] = ["..", ""]


def setup(app: Sphinx) -> dict[str, bool]:
    """Called by Sphinx."""
    # Before, a name stands there twice, as a link and without.
    app.connect("doctree-resolved", _shorten)
    app.connect("autodoc-process-signature", _of_fields)
    app.connect("autodoc-process-docstring", _plain_text, priority=400)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
