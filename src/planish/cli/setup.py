"""Commands about the installation: doctor, and completion of commands by the Tab key."""

import os
import shutil
import subprocess
from importlib.resources import files
from pathlib import Path
from typing import Any, ClassVar

import click
from click.shell_completion import (
    CompletionItem,
    ShellComplete,
    add_completion_class,
    get_completion_class,
)

from planish.cli.console import print_json, sentence
from planish.cli.options import PATH, verb
from planish.core.errors import FileError
from planish.core.files import write_whole

_STATE_TEXTS = {"pass": "ok", "unknown": "note", "look": "look", "fail": "PROBLEM"}


@verb("planish doctor", "planish doctor --json > doctor.json", "planish doctor --report report.txt")
@click.option("--json", "as_json", is_flag=True, help="Print the checks as JSON.")
@click.option(
    "--report",
    type=PATH,
    metavar="FILE",
    help="Write versions, settings, checks and the last fault into a file to hand on.",
)
def doctor(as_json: bool, report: Path | None) -> int:
    """Check the installation: versions, compile cache, memory, disks, console, extras.

    The text can be mailed as it is: it names no folder, except one that cannot be written. The exit
    code is 0 if all is well, and 4 otherwise.
    """
    from planish.installation import check_installation, describe_installation, report_text

    if report is not None:
        write_whole(report, report_text().encode())
        click.echo(f"{report}: written. {describe_installation()['report']}")
        return 0
    versions = describe_installation()
    if not as_json:
        click.echo(
            f"planish {versions['planish']}, Python {versions['python']}, {versions['system']}"
        )
        click.echo(f"From {versions['source']}. {versions['report']}")
    checks = list(check_installation())
    faulty = [check.name for check in checks if check.state in ("look", "fail")]
    if as_json:
        records = [
            check.model_dump(include={"name", "state", "sentence", "advice"}) for check in checks
        ]
        print_json({**versions, "well": not faulty, "checks": records})
    else:
        for check in checks:
            text = f"{_STATE_TEXTS[check.state]:<8}{check.name}: {check.sentence} {check.advice}"
            sentence(text.rstrip())
        click.echo(f"Not well: {', '.join(faulty)}." if faulty else "All is well.")
    return 4 if faulty else 0


SHELLS = ("bash", "zsh", "fish", "powershell")


@add_completion_class
class PowerShellComplete(ShellComplete):
    """Completion for PowerShell.

    PowerShell completes names of files by itself where the program gives nothing.
    """

    name: ClassVar[str] = "powershell"
    source_template: ClassVar[str] = (files("planish.cli") / "completion.ps1").read_text(
        encoding="utf-8"
    )

    def get_completion_args(self) -> tuple[list[str], str]:
        """Words of the command line before the cursor, and the one at it."""
        words = [word.strip("\"'") for word in os.environ["COMP_WORDS"].split("\n")]
        incomplete = os.environ["COMP_CWORD"].strip("\"'")
        arguments = words[1:]
        if incomplete and arguments and arguments[-1] == incomplete:
            arguments.pop()
        return arguments, incomplete

    def format_completion(self, item: CompletionItem[Any]) -> str:
        """One line for a completion: kind, word, what it is."""
        return f"{item.type}\t{item.value}\t{' '.join((item.help or '').split())}"


def script_of(shell: str) -> str:
    """Text that a shell reads to complete commands of planish."""
    completer = get_completion_class(shell)
    assert completer is not None
    # The script holds the program's name and no command; the name of the variable is click's rule.
    program = click.Command("planish")
    # Not the method of the class for bash, which starts bash to look at its version.
    return ShellComplete.source(completer(program, {}, "planish", "_PLANISH_COMPLETE"))


@verb("planish completion bash --install", "planish completion powershell >> $PROFILE")
@click.argument("shell", type=click.Choice(SHELLS))
@click.option(
    "--install", is_flag=True, help="Install it for SHELL in your own account, and print where."
)
def completion(shell: str, install: bool) -> None:
    """Print the script with which SHELL completes commands and options of planish, or install it.

    --install writes one file into your own folders. For bash, zsh and PowerShell it also adds one
    line to the start file of SHELL. New terminals then complete with the Tab key. To undo it,
    remove both.
    """
    if not install:
        click.echo(script_of(shell), nl=False)
        return
    for line in install_script(shell):
        click.echo(line)


def install_script(shell: str) -> list[str]:
    """Write the script and what loads it; return what was done.

    FileError where a file or PowerShell is missing.
    """
    script, profile, line = _places(shell)
    report_lines = [f"{script}: written"]
    try:
        script.parent.mkdir(parents=True, exist_ok=True)
        script.write_text(script_of(shell), encoding="utf-8", newline="\n")
        if profile is not None:
            report_lines.append(f"{profile}: {_add_line(profile, line)}")
    except OSError as error:
        raise FileError(
            f"{error.filename or script} cannot be written: {error.strerror}. Print the script with"
            f" 'planish completion {shell}' and put it where {shell} reads it."
        ) from error
    return [*report_lines, "Open a new terminal; the Tab key then completes commands and options."]


def _places(shell: str) -> tuple[Path, Path | None, str]:
    """Where the script of a shell stands, the file that loads it, and by which line.

    No such file, and an empty line, where the shell reads what lies in a folder.
    """
    home = Path.home()
    if shell == "fish":  # reads what lies there
        config_folder = Path(os.environ.get("XDG_CONFIG_HOME") or home / ".config")
        return config_folder / "fish" / "completions" / "planish.fish", None, ""
    if shell == "powershell":
        profile = _profile()
        script = profile.with_name("planish.completion.ps1")
        # Beside the profile: no letters that an old code page lacks.
        return script, profile, f'. "$PSScriptRoot/{script.name}"'
    data_folder = Path(os.environ.get("XDG_DATA_HOME") or home / ".local" / "share") / "planish"
    script = data_folder / f"completion.{shell}"
    if shell == "zsh":
        profile = Path(os.environ.get("ZDOTDIR") or home) / ".zshrc"
        # compdef is known after compinit only
        return script, profile, f'autoload -Uz compinit && compinit && source "{script}"'
    return script, home / ".bashrc", f'source "{script}"'


def _add_line(profile: Path, line: str) -> str:
    """Add a line to a file that has it not; give the words that say what was done.

    ``line`` comes without its end. A file that is not there is made; the rest of the file stays.
    """
    content = profile.read_bytes() if profile.is_file() else b""
    # As PowerShell 5 writes its files.
    encoding = "utf-16-le" if content.startswith(b"\xff\xfe") else "utf-8"
    text = content.decode(encoding, errors="replace")
    if line in text.removeprefix("\ufeff").splitlines():
        return "has the line already"
    separator = "" if text.endswith("\n") or not text else "\n"
    with profile.open("ab") as file:
        file.write(f"{separator}{line}\n".encode(encoding))
    return f"one line added: {line}"


def _profile() -> Path:
    """The file that PowerShell reads at its start, as it says itself.

    Documents may lie on a server.
    """
    for executable in filter(None, map(shutil.which, ("pwsh", "powershell"))):
        command = [
            executable,
            "-NoProfile",
            "-NonInteractive",
            "-Command",
            "$PROFILE.CurrentUserCurrentHost",
        ]
        reply = subprocess.run(command, capture_output=True, check=False, timeout=60)
        text = reply.stdout.decode("utf-8", errors="replace").strip()
        if reply.returncode == 0 and text:
            return Path(text)
    raise FileError(
        "PowerShell is not on the search path, so its profile is not known. Write the script there"
        " yourself: planish completion powershell >> $PROFILE"
    )
