"""The program `aerodima`: finds the commands of every installed package, turns errors into a line
and an exit status.

A package adds commands with an entry point in the group `aerodima.commands` that names a function
`register(app: typer.Typer) -> None`. Everything a command needs beyond the standard library and
Typer is imported inside the command, so that `aerodima --help` answers at once.

Exit statuses are those of `options.Status`.
"""

from __future__ import annotations

import sys
import traceback
from importlib.metadata import entry_points
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from aerodima.workbench.cli.options import SECTIONS, Status
from aerodima.workbench.core.errors import UserError

ENTRY_POINT_GROUP = "aerodima.commands"
RENAMED = {
    **dict.fromkeys(("turn", "straight", "slalom"), "run SCENARIO"),
    **{old: f"log {old}" for old in ("metrics", "compare")},
    **{old: f"models {old}" for old in ("coefficients", "diagram", "export", "range-of-motion")},
    "rig run": "rig SCENARIO",
    "threshold": "sweep threshold",
    "optimise": "swing search",
    "corner": "swing judge",
    "verify": "swing verify",
    "report": "calibrate",
    "firmware": "drive firmware SCENARIO --ports FILE --out FOLDER",
    **dict.fromkeys(("--log", "--csv", "--save"), "--out"),
    **dict.fromkeys(("--scenario", "--emulate"), "the argument SCENARIO"),
    "--replay": "--html",
    "--played": "--cars",
}
"""Commands and options of version 0.2, and what they are called now; goes with the next version."""


class ErrorBoundary(TyperGroup):
    """The outermost group: what a user can fix becomes one line; any other exception is a bug, its
    traceback stays.
    """

    def invoke(self, ctx: Any) -> Any:  # Typer's own class of the context is private
        """Run the command; raises `typer.Exit` with a `Status`."""
        try:
            return super().invoke(ctx)
        except UserError as error:
            message = str(error)
            cause: BaseException = error
        except OSError as error:
            # Such an error is not about a file that the user named: closed pipe, lost network.
            if error.filename is None:
                raise
            message = f"{error.filename}: {error.strerror}"
            cause = error
        except Exception as error:
            # The error about an option that is not there has its name.
            option = getattr(error, "option_name", "")
            if option not in RENAMED:
                raise
            message = f"{option} is now {RENAMED[option]}"
            cause = error
        except KeyboardInterrupt as error:
            print("interrupted", file=sys.stderr)
            raise typer.Exit(Status.INTERRUPTED) from error
        print(f"error: {message}", file=sys.stderr)
        raise typer.Exit(Status.WRONG) from cause

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """The command that is asked for; UserError with the new name where the old one is used."""
        for old in (args[0], " ".join(args[:2])):
            if old in RENAMED and self.get_command(ctx, old) is None and not ctx.resilient_parsing:
                raise UserError(f"`aerodima {old}` is now `aerodima {RENAMED[old]}`")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Lists the commands by section, those of other packages last."""
        commands = [(name, self.get_command(ctx, name)) for name in self.list_commands(ctx)]
        room = formatter.width - 6 - max(len(name) for name, _ in commands)
        sections: dict[str, list[tuple[str, str]]] = {
            title: [] for title in (*SECTIONS, "Commands")
        }
        for name, command in commands:
            if command is not None and not command.hidden:
                panel = getattr(command, "rich_help_panel", None)
                title = panel if panel in SECTIONS else "Commands"
                sections[title].append((name, command.get_short_help_str(room)))
        for title, rows in sections.items():
            if rows:
                with formatter.section(title):
                    formatter.write_dl(rows)


def _print_version(asked: bool) -> None:
    if asked:
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
    """The program with the commands of every installed package, sorted by the name of the entry
    point.

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
    for entry_point in sorted(entry_points(group=ENTRY_POINT_GROUP), key=lambda found: found.name):
        try:
            entry_point.load()(app)
        except Exception as error:
            error.add_note(
                f"while registering the commands of {entry_point.name!r} ({entry_point.value})"
            )
            raise
    return app


def main() -> None:
    """Entry point of the console command."""
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
