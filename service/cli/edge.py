"""The edge of the process: turn what goes wrong into one sentence and an exit code.

Exit codes: 0 done, 1 failed, 2 wrong usage or input, 130 interrupted.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import typer

from service.errors import InvalidInput, NotFound, WaysideError

FAILED = 1
WRONG_INPUT = 2
INTERRUPTED = 130


@contextmanager
def one_sentence() -> Iterator[None]:
    """Let a command (as its decorator) end a foreseen failure in a sentence instead of a traceback."""
    try:
        yield
    except InvalidInput as error:
        say(str(error))
        for field in error.errors[1:]:  # the message tells of the first
            say(f"{field.pointer or 'body'}: {field.reason}")
        raise typer.Exit(WRONG_INPUT) from None
    except NotFound as error:
        say(str(error))
        raise typer.Exit(WRONG_INPUT) from None
    except WaysideError as error:
        say(str(error))
        raise typer.Exit(FAILED) from None
    except OSError as error:
        place = f"{error.filename}: " if error.filename else ""
        say(f"{place}{error.strerror or error}")
        raise typer.Exit(FAILED) from None
    except KeyboardInterrupt:
        raise typer.Exit(INTERRUPTED) from None


def say(sentence: str) -> None:
    """Tell the user something beside the result: on standard error."""
    typer.echo(sentence, err=True)
