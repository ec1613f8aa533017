"""Extras of the installed distribution: what each brings, and the command that installs one."""

import json
import re
from importlib.metadata import distribution, requires
from importlib.util import find_spec
from os.path import relpath
from pathlib import Path

from aerodima.workbench.core.errors import UserError

DISTRIBUTION = "aerodima-workbench"
"""Name of the distribution in `pyproject.toml`."""
ROOT = Path(__file__).resolve().parents[2]
"""Folder of the checkout, or of the package `aerodima` of an installed wheel; both have
`constraints.txt`."""
_REQUIREMENT = re.compile(r"^([\w.-]+).*; extra == ['\"]([\w-]+)", re.MULTILINE)


def require(extra: str, subject: object, *modules: str, error: type[UserError] = UserError) -> None:
    """Raise an error with the command that installs an extra if one of its modules is missing.

    Args:
        extra: name of one extra, or of several with commas.
        subject: what needs the modules; the beginning of the message.
        modules: names of the modules as in `import`.
        error: class of the error raised.
    """
    for module in modules:
        if find_spec(module) is None:
            raise error(f"{subject}: {module} is missing: {install_command(extra)}")


def install_command(extra: str) -> str:
    """Make the command that adds an extra, with the tested versions, to what is installed.

    A checkout is named by its folder, and a wheel that came from a file by its address: pip finds
    the distribution by its name only if it came from an index.
    """
    if (ROOT / "pyproject.toml").is_file():
        source = f"-e '{relpath(ROOT)}[{extra}]'"
    else:
        source = f"'{DISTRIBUTION}[{extra}]{_address()}'"
    return f"pip install {source} -c {relpath(ROOT / 'constraints.txt')}"


def packages_of_extras() -> dict[str, list[str]]:
    """Read from the installed metadata the distributions that each extra brings, by its name."""
    packages: dict[str, list[str]] = {}
    for package, extra in _REQUIREMENT.findall("\n".join(requires(DISTRIBUTION) or ())):
        packages.setdefault(extra, []).append(package)
    return packages


def _address() -> str:
    """Read the address of the installed wheel, ` @ URL` (PEP 610); empty if it is from an index."""
    text = distribution(DISTRIBUTION).read_text("direct_url.json")
    return f" @ {json.loads(text)['url']}" if text else ""
