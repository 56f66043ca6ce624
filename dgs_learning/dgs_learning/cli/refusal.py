"""How a command ends when its input is bad: code and sentence on stderr, exit code 2."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import NoReturn

import typer

from dgs_description.errors import DgsError

BAD_INPUT = 2


@contextmanager
def refusals(*also: type[Exception]) -> Iterator[None]:
    """Turn a `DgsError` of the block, or an exception that is named, into the command's end."""
    try:
        yield
    except DgsError as error:
        typer.echo(f"error {error.code.value} {error.code.name}: {error.message}", err=True)
        raise typer.Exit(BAD_INPUT) from None
    except BrokenPipeError:  # of `dgs ... | head`, which ends quietly
        raise
    except also as error:
        refuse(str(error))


def refuse(sentence: str) -> NoReturn:
    """End the command with a sentence that names what is missing."""
    typer.echo(sentence, err=True)
    raise typer.Exit(BAD_INPUT)
