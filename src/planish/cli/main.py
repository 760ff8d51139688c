"""The command group, and the one place where an error becomes a message and an exit code.

0 done; 1 a fault of planish; 2 wrong usage; 3 input that cannot be used; 4 finished, but a check
failed; 5 memory or disk used up; 130 interrupted.
"""

import ast
import atexit
import gc
import json
import logging
import os
import sys
import tempfile
import threading
import traceback
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any, cast

import click

from planish import __version__
from planish.cli.console import prepare_streams, shown
from planish.core.errors import FileError, PlanishError
from planish.core.parameter_words import in_terminal_words

_MODULES = {
    "link": "runs",
    "map": "runs",
    "demo": "runs",
    "run": "runs",
    "info": "files",
    "import": "files",
    "properties": "files",
    "surface": "stages",
    "measure": "stages",
    "flatten": "stages",
    "resample": "stages",
    "holes": "stages",
    "register": "stages",
    "correlate": "stages",
    "scales": "scales",
    "report": "stages",
    "marks": "marks",
    "specimen": "validate",
    "validate": "validate",
    "export": "export",
    "doctor": "setup",
    "completion": "setup",
    "new": "runs",
    "study": "series",
    "compare": "series",
    "view": "export",
    "explore": "export",
    "explain": "explain",
}
"""Verb -> module of this package that holds it, as ``verb``, ``verb_`` where the name is taken."""


class LazyGroup(click.Group):
    """A group whose commands are imported when they are used."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002
        """Names of the verbs."""
        return list(_MODULES)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:  # noqa: ARG002
        """Import one verb."""
        if cmd_name not in _MODULES:
            return None
        module: Any = import_module(f"planish.cli.{_MODULES[cmd_name]}")
        return getattr(module, f"{cmd_name}_", None) or getattr(module, cmd_name)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:  # noqa: ARG002
        """List the verbs with what their docstrings say.

        Importing them all would take longer than all else.
        """
        folder = Path(__file__).parent
        docstrings = dict[str, str | None]()
        for module in set(_MODULES.values()):
            tree = ast.parse((folder / f"{module}.py").read_text(encoding="utf-8"))
            functions = [node for node in tree.body if isinstance(node, ast.FunctionDef)]
            docstrings |= {function.name: ast.get_docstring(function) for function in functions}
        limit = formatter.width - 6 - max(map(len, _MODULES))
        rows: list[tuple[str, str]] = []
        for name in _MODULES:
            verb = click.Command(name, help=docstrings.get(f"{name}_") or docstrings[name])
            rows.append((name, verb.get_short_help_str(limit)))
        with formatter.section("Commands"):
            formatter.write_dl(rows)


_START_TEXT = """\
planish {version} links 3D scans of paper sheets to 2D images of them.

See it work:       planish demo
Look at a file:    planish info FILE
Link your own:     planish new STUDY.toml VOLUME IMAGE
                   planish run STUDY.toml

planish --help lists all commands; planish doctor checks the installation.
"""


@click.group(
    cls=LazyGroup,
    subcommand_metavar="COMMAND [ARGS]...",
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.version_option(__version__, prog_name="planish")
@click.pass_context
def planish(context: click.Context) -> None:
    """Link the 3D structure of a paper sheet to a 2D image of it.

    'planish link VOLUME IMAGE --out RUN' does the whole line; 'planish demo' shows it on a
    synthetic specimen. Each stage is a command too: surface, measure, flatten, resample, holes,
    register, correlate, report.

    Exit codes: 0 done, 1 a fault of planish, 2 wrong usage, 3 input that cannot be used, 4 finished
    but a check failed (--strict: or asks for a look), 5 memory or disk used up, 130 interrupted.
    """
    if context.invoked_subcommand is None:
        click.echo(_START_TEXT.format(version=__version__), nl=False, err=True)
        # Wrong usage: a script whose arguments got lost must not take it for a success.
        context.exit(2)


def main(args: list[str] | None = None) -> None:
    """Run the command line and end the process with its exit code."""
    arguments = sys.argv[1:] if args is None else args
    prepare_streams()
    # Imports and compiled functions make many small objects, and hardly any is garbage.
    gc.set_threshold(50_000)
    if os.environ.get("_PLANISH_COMPLETE", "").startswith("powershell"):
        import_module("planish.cli.setup")  # click knows the other shells by itself
    # Of zarr, about reads that a damaged chunk cut short.
    logging.getLogger("asyncio").setLevel(logging.CRITICAL)
    try:
        code = planish.main(args=arguments, prog_name="planish", standalone_mode=False)
    except click.exceptions.Exit as error:
        code = error.exit_code
    except click.ClickException as error:
        error.show()
        code = error.exit_code
    except (click.Abort, KeyboardInterrupt):
        click.echo("planish: interrupted; nothing was written.", err=True)
        code = 130
    except Exception as error:  # noqa: BLE001  a user gets a sentence and a log
        fault = _as_planish_error(error)
        code = fault.exit_code
        click.echo(f"planish: {shown(fault.text)}", err=True)
        if "--json" in arguments:
            click.echo(json.dumps({"error": in_terminal_words(fault.text), "exit_code": code}))
    status = code if isinstance(code, int) else 0
    if args is None:
        _end_process(status)
    sys.exit(status)


def _end_process(status: int) -> None:
    """End the process as Python does, but free no module and no array one by one.

    That takes most of a second. Where a stream cannot be flushed nothing is done: Python says so.
    """
    with suppress(OSError, ValueError):
        cast("Any", threading)._shutdown()
        cast("Any", atexit)._run_exitfuncs()
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)


def _as_planish_error(error: Exception) -> PlanishError:
    """The sentence for a user; a fault of planish comes with a log of its details."""
    from planish.core.files import as_sentence
    from planish.installation import ANOTHER_CACHE, NO_CACHE, is_no_cache

    if is_no_cache(error):
        return FileError(f"{NO_CACHE} {ANOTHER_CACHE}")
    remedy = "Use a smaller or coarser volume, or a machine with more memory."
    fault = as_sentence(error, "the results", remedy)
    if fault is error or fault.exit_code != PlanishError.exit_code:
        return fault
    with tempfile.NamedTemporaryFile(
        "w", prefix="planish-", suffix=".log", delete=False, encoding="utf-8"
    ) as log:
        log.write(f"planish {__version__}\n")
        log.write("".join(traceback.format_exception(error)))
    details_text = (
        f"The details are in {Path(log.name)}, and 'planish doctor --report FILE' writes them"
        " and the installation into one file to hand on."
    )
    return PlanishError(fault.text.replace("Please report it", f"{details_text} Please report it"))
