"""The page of the documentation on what the thesis states about the built car."""

from aerodima.workbench.report.statements import Settled, Statement, Verdict, load_statements

_VERDICTS: tuple[Verdict, ...] = ("agrees", "adopted", "differs", "not checkable")
_INTRODUCTION = """# The car as it was built

What the thesis states about the built car and its tail, in our words, beside what the model has. The page is made from
`models/published/statements.yaml`; a test finds every figure of ours again: in the parameter files, in the code, or in
a run of the car of the parameter files. *Agrees*: found, nobody put it in. *Adopted*: put into the model or calibrated
to, so no evidence. *Differs*: with the reason. Runs turn after 2 s, as the simulated car of the thesis, those beyond
5 m/s after 6 s: the real car had 15 s. What the ensemble says: [What is reproduced](reproduced.md).
"""


def statements_page() -> str:
    """The page as Markdown."""
    file = load_statements()
    verdicts = [statement.verdict for statement in file.statements]
    counts = ", ".join(f"{verdicts.count(verdict)} {verdict}" for verdict in _VERDICTS)
    lines = [_INTRODUCTION, f"{len(verdicts)} statements: {counts}."]
    for topic in file.topics:
        lines += ["", f"## {topic.name}", "", _row("section", "statement", "published", "ours", "verdict", "")]
        lines += ["|" + "---|" * 6, *map(_statement_row, topic.statements)]
    lines += ["", "## Contradictions between thesis and model, and how each was settled", ""]
    lines += [_row("", "section", "thesis", "the model had", "settled", "how"), "|" + "---|" * 6]
    lines += [_settled_row(number, point) for number, point in enumerate(file.settled, start=1)]
    return "\n".join(lines) + "\n"


def _statement_row(one: Statement) -> str:
    sign = {"at least": "≥ ", "at most": "≤ ", "equal": ""}[one.compare]
    ours = "" if one.our_value is None else f"{_with_unit(one.our_value, one.unit)} ({one.kind} `{one.source}`)"
    published = sign + _with_unit(one.published, one.unit)
    return _row(one.section, one.says, published, ours, f"**{one.verdict}**", one.reason)


def _settled_row(number: int, point: Settled) -> str:
    about, settled = f"{number}. {point.about}", f"**{point.settled}**"
    return _row(about, point.section, point.thesis, point.had, settled, point.how)


def _with_unit(value: bool | float | str, unit: str) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return value if isinstance(value, str) else f"{value:.5g}" + ("" if unit in ("", "1") else f" {unit}")


def _row(*cells: str) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"
