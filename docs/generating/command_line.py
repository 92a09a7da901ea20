"""Every command and option, as click knows them."""

from __future__ import annotations

import click

from contactqp.cli import command
from docs.generating.tables import table


def command_line() -> str:
    """A section for each command: how it is called, what it does, its arguments and options."""
    context = click.Context(command, info_name="contactqp")
    return "\n\n".join(_section(name, context) for name in command.list_commands(context))


def _section(name: str, parent: click.Context) -> str:
    found = command.get_command(parent, name)
    assert found is not None
    context = click.Context(found, info_name=name, parent=parent)
    usage = f"`{' '.join([context.command_path, *found.collect_usage_pieces(context)])}`"
    options = [option for option in found.params if isinstance(option, click.Option)]
    rows = [(_names(option), _explained(option)) for option in options]
    parts = [f"## contactqp {name}", usage, _paragraphs(found.help or "")]
    return "\n\n".join([*parts, table(("option", "meaning"), rows)] if rows else parts)


def _paragraphs(text: str) -> str:
    return "\n\n".join(" ".join(paragraph.split()) for paragraph in text.split("\n\n"))


def _names(option: click.Option) -> str:
    taken = "" if option.is_flag else f" {option.metavar or _choices(option)}"
    return "`" + ", ".join(option.opts) + taken + "`"


def _choices(option: click.Option) -> str:
    kind = option.type
    return "|".join(kind.choices) if isinstance(kind, click.Choice) else kind.name.upper()


def _explained(option: click.Option) -> str:
    default = f" Default: `{option.default}`." if option.show_default else ""
    repeated = " May be repeated." if option.multiple and "repeated" not in (option.help or "") else ""
    return (option.help or "") + default + repeated
