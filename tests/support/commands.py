"""The options of the command `dgs`."""

from __future__ import annotations

import typer

from dgs_learning.cli.app import app
from dgs_learning.training.__main__ import parser

COMMANDS = typer.main.get_command(app).commands  # type: ignore[attr-defined]


def options_of(command: str) -> set[str]:
    """Of a subcommand. `dgs train` hands its words on to the parser of the training."""
    if command == "train":
        return set(parser()._option_string_actions)
    return {
        name
        for parameter in COMMANDS[command].params
        for name in (*parameter.opts, *parameter.secondary_opts)
    }
