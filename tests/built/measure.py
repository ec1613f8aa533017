"""Measures every check and run again and writes what they found into
`models/published/statements.yaml`.

`python -m tests.built.measure [PART OF A NAME]`. Verdicts and reasons stay: `load_statements` names
each that no longer follows from its values.
"""

import re
import sys

from aerodima.workbench.core.errors import ModelError
from aerodima.workbench.core.resources import model_path
from tests.built.found import CHECKS, RUNS
from tests.built.statements import FILE, load_statements


def written(value):
    """As YAML, numbers with five digits."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return (
            f"{value:.5g}" if "e" in f"{value:.5g}" or "." in f"{value:.5g}" else f"{value:.5g}.0"
        )
    return f'"{value}"' if "," in value else value


def main(part):
    """Measures what has `part` in its name."""
    path = model_path(FILE)
    for kind, known in (("check", CHECKS), ("run", RUNS)):
        for name, find in known.items():
            text = path.read_text(encoding="utf-8")
            line = re.compile(rf'(ours: {kind} {name}, measured: )("[^"]*"|[^,}}]*)')
            match = line.search(text)
            if part not in name or match is None:
                continue
            value = written(find())
            if value != match[2]:
                print(f"{name}: {match[2]} -> {value}", flush=True)
                path.write_text(
                    line.sub(lambda found, new=value: found[1] + new, text), encoding="utf-8"
                )
    try:
        load_statements()
    except ModelError as error:
        print(str(error).replace("; /", "\n/"))


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "")
