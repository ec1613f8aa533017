"""The main guard of a script: every worker process imports the script that starts it."""

import ast
import sys
import threading
from pathlib import Path

from aerodima.workbench.core.errors import UserError

_GUARD = 'if __name__ == "__main__":'


def refuse_unguarded_script() -> None:
    """Raise UserError if the running script is about to start workers outside of its guard.

    Each worker would run these lines again, and would start workers of its own. A notebook, a
    prompt, a program without a file and a `__main__.py` have no lines that a worker runs.
    """
    main = sys.modules["__main__"]
    script = getattr(main, "__file__", None)
    if getattr(main.__spec__, "name", "").rpartition(".")[2] == "__main__":
        script = None
    frame = sys._current_frames().get(threading.main_thread().ident or 0)
    while frame is not None:
        if frame.f_code.co_name == "<module>" and frame.f_globals is vars(main):
            break
        frame = frame.f_back
    if script is None or frame is None or not Path(script).is_file():
        return
    line = frame.f_lineno
    try:
        tree = ast.parse(Path(script).read_bytes())
    except (SyntaxError, ValueError):  # compiled: no source text
        return
    guards = [
        node
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and "__name__" in ast.unparse(node.test)
    ]
    if not any(guard.lineno <= line <= (guard.end_lineno or 0) for guard in guards):
        raise UserError(
            f"{script}, line {line}: starts worker processes, which run the script again; put this "
            f"line, and what else is to run once, below {_GUARD}"
        )
