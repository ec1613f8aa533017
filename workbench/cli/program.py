"""The program `aerodima`: commands of every installed package; errors become a line and a status.

A package adds commands with an entry point in the group `aerodima.commands` that names a function
`register(app: typer.Typer) -> None`. Everything a command needs beyond the standard library and
Typer is imported inside the command, so that `aerodima --help` answers at once.

Exit statuses are those of `options.Status`.
"""

import errno
import sys
import traceback
from importlib.metadata import entry_points
from io import TextIOWrapper
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from aerodima.workbench.cli.options import SECTIONS, Status
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.core.terminal import say

ENTRY_POINT_GROUP = "aerodima.commands"
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""Errors of a full disk, with or without the name of a file."""


class ErrorBoundary(TyperGroup):
    """Outermost group of commands: a user's error becomes one line, a bug keeps its traceback."""

    def invoke(self, ctx: Any) -> Any:  # Typer's own class of the context is private
        """Run the command; raises `typer.Exit` with a `Status`."""
        try:
            return super().invoke(ctx)
        except UserError as error:
            message = str(error)
            cause: Exception = error
        except OSError as error:
            # Such an error is not about a file that the user named: closed pipe, lost network.
            if error.filename is None and error.errno not in FULL:
                raise
            message = f"{error.filename or 'disk'}: {error.strerror}"
            cause = error
        except KeyboardInterrupt as error:
            say("interrupted", err=True)
            raise typer.Exit(Status.INTERRUPTED) from error
        say(f"error: {message}", err=True)
        raise typer.Exit(Status.WRONG) from cause

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """List the commands by section, those of other packages last."""
        names = self.list_commands(ctx)
        room = formatter.width - 6 - max(map(len, names))
        sections: dict[str, list[tuple[str, str]]] = {
            title: [] for title in (*SECTIONS, "Commands")
        }
        for name in names:
            command = self.get_command(ctx, name)
            panel = getattr(command, "rich_help_panel", None)
            title = panel if panel in SECTIONS else "Commands"
            if command is not None and not command.hidden:
                sections[title].append((name, command.get_short_help_str(room)))
        for title, rows in sections.items():
            if rows:
                with formatter.section(title):
                    formatter.write_dl(rows)


def _print_version(wanted: bool) -> None:
    if wanted:
        from aerodima.workbench import __version__

        print(f"aerodima {__version__}")
        raise typer.Exit


def _root(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version and exit."
        ),
    ] = False,
) -> None:
    """Model, identify, optimise and drive the AeroDima car and its aerodynamic tail."""


def build_app() -> typer.Typer:
    """Build the program with the commands of every installed package, sorted by entry point.

    An exception while a package registers its commands names that package and is raised: half a
    program helps nobody.
    """
    app = typer.Typer(
        name="aerodima",
        cls=ErrorBoundary,
        no_args_is_help=True,
        add_completion=True,
        context_settings={"help_option_names": ["-h", "--help"]},
        rich_markup_mode=None,  # importing Rich takes as long as all the rest of `--help`
        pretty_exceptions_enable=False,  # a bug report needs the plain traceback
    )
    app.callback()(_root)
    for entry_point in sorted(entry_points(group=ENTRY_POINT_GROUP), key=lambda point: point.name):
        try:
            entry_point.load()(app)
        except Exception as error:
            error.add_note(
                f"while registering the commands of {entry_point.name!r} ({entry_point.value})"
            )
            raise
    return app


def main() -> None:
    """Run the console command; a character that the terminal's encoding lacks is escaped."""
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        build_app()()
    except KeyboardInterrupt:  # before a command began
        print("interrupted", file=sys.stderr)
        sys.exit(Status.INTERRUPTED)
    except Exception:
        traceback.print_exc()
        sys.exit(Status.BUG)


if __name__ == "__main__":
    main()
