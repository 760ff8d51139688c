"""``planish doctor``: whether the installation can do its work."""

from __future__ import annotations

import json

import click

from planish.cli.console import sentence
from planish.cli.options import verb

_WORDS = {"pass": "ok", "unknown": "note", "look": "look", "fail": "PROBLEM"}


@verb("planish doctor", "planish doctor --json > doctor.json", name="doctor")
@click.option("--json", "as_json", is_flag=True, help="Print the checks as JSON.")
def doctor(as_json: bool) -> int:
    """Check the installation: versions, compile cache, memory, disks, console, extras.

    The text can be mailed as it is: it holds no names of folders, but for one that cannot be written. The exit code is
    0 where all is well, and 4 otherwise.
    """
    from planish.installation import check_installation, describe_installation

    about = describe_installation()
    if not as_json:
        click.echo(f"planish {about['planish']}, Python {about['python']}, {about['system']}")
    checks = list(check_installation())
    wrong = [check for check in checks if check.state in ("look", "fail")]
    if as_json:
        records = [check.model_dump(include={"name", "state", "sentence", "advice"}) for check in checks]
        click.echo(json.dumps({**about, "well": not wrong, "checks": records}, indent=2))
    else:
        for check in checks:
            sentence(f"{_WORDS[check.state]:<8}{check.name}: {check.sentence} {check.advice}".rstrip())
        names = ", ".join(check.name for check in wrong)
        click.echo(f"Not well: {names}." if wrong else "All is well.")
    return 4 if wrong else 0
