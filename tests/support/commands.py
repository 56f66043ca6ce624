"""The command `dgs`: run, and as its own parsers read it."""

from __future__ import annotations

import re
from collections.abc import Sequence

import typer
from typer.testing import CliRunner, Result

from dgs_learning.cli.app import app
from dgs_learning.training.__main__ import parser

_COMMANDS = typer.main.get_command(app).commands  # type: ignore[attr-defined]


def dgs(words: Sequence[str], code: int = 0) -> Result:
    """Run `dgs` with these words in this process; it must end with this exit code."""
    result = CliRunner().invoke(app, words)
    assert result.exit_code == code, result.output
    return result


def read_dgs(*words: str) -> None:
    """Read the words after `dgs`.

    Files need not be there, and what must be given may be missing; a word in capitals or a variable of the shell stands
    for any value.

    Raises:
        KeyError: there is no such subcommand.
        SystemExit: an option or a value of `dgs train` is refused.
        Exception: an option or a value of another subcommand is refused.
    """
    name, *arguments = words
    if name == "--help":
        return
    if name == "train":  # it hands its words on
        parser().parse_args([re.sub(r"^\$.*", "1", word) for word in arguments])
        return
    command = _COMMANDS[name]
    context = command.context_class(command, info_name=name)
    values, rest, order = command.make_parser(context).parse_args(args=list(arguments))
    if rest:
        raise ValueError(f"dgs {name} takes no {rest}")
    for parameter in order:
        if not str(value := values[parameter.name]).isupper():
            try:
                parameter.process_value(context, value)
            except Exception as error:
                if type(error).__name__ != "MissingParameter" and "does not exist" not in str(error):
                    raise
