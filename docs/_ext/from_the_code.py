"""Parts of pages that are made from the code itself.

A line ``<!-- made: NAME -->`` in a page becomes what the function of that name in `MADE` returns.
"""

import re
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from sphinx.application import Sphinx

_LINE = re.compile(r"^<!-- made: ([\w ]+) -->$", re.MULTILINE)


def _cell(text: object) -> str:
    """Text in a cell of a table."""
    return " ".join(str(text).split()).replace("|", "\\|")


def settings() -> Iterator[str]:
    """Every table of the pipeline file, from the models that files are checked against."""
    from pcnav.config.commented import explained_tables

    for table in explained_tables():
        yield f"## [{table.name}]\n" if table.name else "## Before the first table\n"
        if table.explained:
            about = table.explained.removeprefix(f"[{table.name}]: ")
            yield f"{_escaped(about[:1].upper() + about[1:])}\n"
        yield "| key | default | takes | what it means |"
        yield "| --- | --- | --- | --- |"
        for key in table.keys:
            default = "" if key.value is None else f"`{_cell(key.value)}`"
            takes = key.allowed if '"' not in key.allowed else key.allowed.replace(" | ", ", ")
            meaning = _cell(_escaped(key.explained))
            yield f"| `{key.name}` | {default} | {_cell(takes)} | {meaning} |"
        yield ""


def _escaped(text: str) -> str:
    """Prose of a docstring in Markdown, where square brackets and stars would be links and such."""
    return re.sub(r"([\[\]*<])", r"\\\1", text.replace("``", "`"))


def commands() -> Iterator[str]:
    """Every command with its arguments and options, from the command line itself."""
    import typer

    from pcnav.cli import app

    group = typer.main.get_command(app)
    for name, command in group.commands.items():  # type: ignore[attr-defined]
        summary, *rest = (command.help or "").split("\n\n")
        yield f"## pcnav {name}\n"
        yield _escaped(" ".join(summary.split())) + "\n"
        for paragraph in rest:
            yield _escaped(" ".join(paragraph.split())) + "\n"
        yield "| argument, option | what it says | default |"
        yield "| --- | --- | --- |"
        for option in command.params:
            words = ", ".join(f"`{one}`" for one in _names_of(option))
            default = option.default if isinstance(option.default, int | float | str) else None
            shown = "" if default is None or isinstance(default, bool) else f"`{default}`"
            yield f"| {words} | {_cell(_escaped(option.help or ''))} | {shown} |"
        yield ""


def _names_of(option: Any) -> tuple[str, ...]:
    """As a command line has it: an option in all its forms, an argument in capitals."""
    if option.param_type_name == "argument":
        return (str(option.metavar or option.name).upper(),)
    return (*option.opts, *option.secondary_opts)


def estimators() -> Iterator[str]:
    """The registry of estimators."""
    from pcnav.estimators.registry import ESTIMATORS

    yield "| name | what it is | lives on | is given of the pose |"
    yield "| --- | --- | --- | --- |"
    for name, entry in ESTIMATORS.items():
        kinds = ", ".join(kind.value.replace("_", " ") for kind in entry.takes)
        yield f"| `{name}` | {_cell(entry.title)} | {kinds} | {_cell(entry.first_pose.value)} |"


def public_names() -> Iterator[str]:
    """What `pcnav.__all__` names, each from its docstring."""
    import inspect

    import pcnav

    yield "```{eval-rst}"
    for name in sorted(pcnav.__all__, key=str.casefold):
        thing = getattr(pcnav, name)
        if inspect.isclass(thing):
            yield f".. autoclass:: pcnav.{name}"
            # The tables of a pipeline have a page of their own.
            yield "" if name == "Pipeline" else "   :members:\n"
        elif inspect.isfunction(thing):
            yield f".. autofunction:: pcnav.{name}\n"
        else:
            # What a value means stands where it is made.
            yield f".. autodata:: {pcnav._HOMES[name]}.{name}\n   :no-value:\n"
    yield "```"


MADE: Mapping[str, Callable[[], Iterator[str]]] = {
    "settings": settings,
    "commands": commands,
    "estimators": estimators,
    "public names": public_names,
}


def made_page(text: str) -> str:
    """A page with what is made for it in place. Raises `KeyError` for a name that is none."""
    return _LINE.sub(lambda found: "\n".join(MADE[found[1]]()), text)


def _read(_app: Sphinx, _name: str, source: list[str]) -> None:
    source[0] = made_page(source[0])


def setup(app: Sphinx) -> dict[str, bool]:
    """Called by Sphinx."""
    app.connect("source-read", _read)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
