"""The blocks of a page of the documentation; `python page_blocks.py PAGE` runs them in order in the
working folder.

It imports nothing of ours: beside a page it runs in an environment that has the wheel and no
checkout.
"""

import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

BLOCK = re.compile(
    r"^```(?P<language>sh|python|yaml|xml)(?: title=\"(?P<title>[^\"]+)\")?\n(?P<text>.*?)^```",
    re.M | re.S,
)


def blocks(page: Path) -> list[re.Match[str]]:
    """Those with a language that is run, or with a title under which they are written to a file."""
    return list(BLOCK.finditer(page.read_text(encoding="utf-8")))


def run_blocks(page: Path, folder: Path, command: Callable[[str, str], None]) -> None:
    """Writes titled blocks into a folder, executes Python in one namespace, and hands each line of
    sh to `command`.

    Args:
        command: called with a line and where it stands.
    """
    names: dict[str, object] = {}
    for block in blocks(page):
        text = block["text"]
        where = f"{page.name}:{block['language']}"
        if block["title"]:
            (folder / block["title"]).write_text(text, encoding="utf-8")
        if block["language"] == "python":
            exec(compile(text, where, "exec"), names)
        elif block["language"] == "sh":
            for line in text.replace("\\\n", " ").splitlines():
                command(line, where)


if __name__ == "__main__":
    run_blocks(
        Path(sys.argv[1]),
        Path.cwd(),
        lambda line, where: subprocess.run(line, shell=True, check=True) and None,
    )
