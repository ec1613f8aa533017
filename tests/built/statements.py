"""What the thesis states about the built car and its tail, beside what the model has, with a
verdict for each.

`models/published/statements.yaml` decides. A published figure is taken from the published tables
where it stands in one, a figure of ours from `models/parameters` where it is a parameter; anything
else names the check or the run of `tests/built` that finds it, and a test finds it again. A verdict
follows from the two values: a row whose verdict no longer fits is an error.
"""

from functools import cache
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, model_validator

from aerodima.workbench.core.errors import ModelError
from aerodima.workbench.core.resources import model_path, published_rows
from aerodima.workbench.core.yaml_files import StrictModel, checked, read_yaml
from aerodima.workbench.scenario.scenario_file import load_parameter_file

FILE = "published/statements.yaml"

Value = bool | float | str
Verdict = Literal["agrees", "adopted", "differs", "not checkable"]
ROUNDING = 1e-4
"""Relative; one number with five digits."""
_SAYS_WHY = ("differs", "not checkable")


def _known_column(address):
    """A published value, or the address of one: table/row or table/row/column."""
    return (
        _published(address)
        if isinstance(address, str) and address.count("/") in (1, 2)
        else address
    )


class Statement(StrictModel):
    """One statement.

    Attributes:
        id: short name, by which others refer to it.
        section: of the thesis, or the table.
        says: the statement in our words.
        published: figure (SI), word or yes/no; in the file also the address of a published figure.
        unit: of both values; empty for a word or a pure number.
        ours: `parameter SECTION.KEY`, `check NAME` or `run NAME`; None where nothing can be
            checked.
        measured: what that check or run found.
        within: largest difference of numbers that still agrees; rounding without it.
        compare: how ours must lie to the published value.
        verdict: agrees (found), adopted (put in), differs, or not checkable.
        reason: why it differs or cannot be checked, and what else a reader must know.
    """

    id: str = Field(pattern=r"^[a-z][a-z0-9_]*$")
    section: str = Field(min_length=1)
    says: str = Field(min_length=1)
    published: Annotated[Value, AfterValidator(_known_column)]
    unit: str = ""
    ours: str | None = Field(None, pattern=r"^(parameter|check|run) [a-z0-9_./]+$")
    measured: Value | None = None
    within: float | None = Field(None, ge=0.0)
    compare: Literal["equal", "at least", "at most"] = "equal"
    verdict: Verdict
    reason: str = ""

    @property
    def kind(self):
        """`parameter`, `check`, `run` or empty."""
        return "" if self.ours is None else self.ours.partition(" ")[0]

    @property
    def source(self):
        """What is behind the kind: a parameter, a check or a run."""
        return "" if self.ours is None else self.ours.partition(" ")[2]

    @property
    def our_value(self):
        """The parameter as it is now, or what the check or the run found."""
        return parameter_entry(self.source).value if self.kind == "parameter" else self.measured

    def holds(self, ours):
        """Whether a value of ours is what the thesis states."""
        if isinstance(ours, bool | str) or isinstance(self.published, bool | str):
            return type(ours) is type(self.published) and ours == self.published
        within = ROUNDING * abs(self.published) if self.within is None else self.within
        above = ours >= self.published - within
        below = ours <= self.published + within
        return {"equal": above and below, "at least": above, "at most": below}[self.compare]

    @model_validator(mode="after")
    def _verdict_follows(self) -> "Statement":
        if self.verdict in _SAYS_WHY and not self.reason:
            raise ValueError(f"verdict {self.verdict!r} needs a reason")
        if (self.verdict == "not checkable") != (self.ours is None):
            raise ValueError(
                f"verdict {self.verdict!r} with ours {self.ours!r}; only what is not checkable "
                "has none"
            )
        if self.ours is None:
            return self
        value = self.our_value
        if value is None or (self.kind == "parameter") != (self.measured is None):
            raise ValueError(
                "measured: allowed is a value for a check or a run, and none for a parameter"
            )
        if self.holds(value) != (self.verdict != "differs"):
            raise ValueError(
                f"{self.id}: verdict {self.verdict!r}, but ours is {value!r} and published "
                f"{self.published!r} "
                f"({self.compare}, within {self.within}); allowed is the verdict that follows"
            )
        return self


class Settled(StrictModel):
    """A contradiction between thesis and model, and how it was settled.

    Attributes:
        about: what it is about. section: of the thesis. thesis: what it says. had: what the model
            had.
        settled: text adopted, shown by runs not to matter, or ours kept.
        how: what was changed or measured, with figures.
        rows: ids of the statements that hold it.
    """

    about: str
    section: str
    thesis: str
    had: str
    settled: Literal["adopted", "does not matter", "ours kept", "open"]
    how: str = Field(min_length=1)
    rows: tuple[str, ...] = ()


class Topic(StrictModel):
    """Statements under one heading."""

    name: str = Field(min_length=1)
    statements: tuple[Statement, ...]


class StatementFile(StrictModel):
    """The file."""

    schema_: Literal["aerodima/statements/1"] = Field(alias="schema")
    topics: tuple[Topic, ...]
    settled: tuple[Settled, ...] = ()

    @property
    def statements(self):
        """All of them, in order."""
        return tuple(statement for topic in self.topics for statement in topic.statements)

    @model_validator(mode="after")
    def _ids_are_known(self) -> "StatementFile":
        ids = [statement.id for statement in self.statements]
        twice = sorted({name for name in ids if ids.count(name) > 1})
        unknown = sorted({row for point in self.settled for row in point.rows if row not in ids})
        if twice or unknown:
            raise ValueError(
                f"ids named twice: {twice}; rows without a statement: {unknown}; allowed: neither"
            )
        return self


def load_statements():
    """Reads the file; ModelError names the row, its value and what is allowed."""
    path = model_path(FILE)
    return checked(StatementFile, read_yaml(path), str(path), ModelError)


def parameter_entry(name):
    """A number of `models/parameters` by its name, such as `rig/robot.kp`; ModelError for an
    unknown one.
    """
    section, _, key = name.rpartition(".")
    entries = _entries(section)
    if key not in entries:
        raise ModelError(f"parameter {name!r}: unknown; {section} has {', '.join(sorted(entries))}")
    return entries[key]


@cache
def _entries(section):
    return load_parameter_file(model_path(f"parameters/{section}.yaml"))


def published_row(address):
    """Row of a published table by table/row: the row's first column, or its first two with a space
    between.

    Raises:
        ModelError: there is no such table or row.
    """
    table, row = address.split("/")[:2]
    for entry in published_rows(table):
        first, second = list(entry.values())[:2]
        if row in (first, f"{first} {second}"):
            return entry
    raise ModelError(f"published value {address!r}: {table} has no row {row!r}")


def _published(address):
    entry = published_row(address)
    column = [*address.split("/"), "value_si"][2]
    if column not in entry:
        raise ModelError(f"published value {address!r}: allowed columns: {', '.join(entry)}")
    try:
        return float(entry[column])
    except ValueError:
        return entry[column]


_VERDICTS = ("agrees", "adopted", "differs", "not checkable")
_INTRODUCTION = """# The car as it was built

What the thesis states about the built car and its tail, in our words, beside what the model has.
The page is made from `models/published/statements.yaml`; a test finds every figure of ours again:
in the parameter files, in the code, or in a run of the default car or of the car on the field.
*Agrees*: found, nobody put it in. *Adopted*: put into the model or calibrated to, so no evidence.
*Differs*: with the reason. The simulated car turns after 2 s, as that of the thesis; the car on the
field is open loop and turns after 4.6 s, as in its calibration.
What the ensemble says: [What is reproduced](reproduced.md).
"""


def statements_page():
    """The page as Markdown."""
    file = load_statements()
    verdicts = [statement.verdict for statement in file.statements]
    counts = ", ".join(f"{verdicts.count(verdict)} {verdict}" for verdict in _VERDICTS)
    lines = [_INTRODUCTION, f"{len(verdicts)} statements: {counts}."]
    for topic in file.topics:
        lines += [
            "",
            f"## {topic.name}",
            "",
            _row("section", "statement", "published", "ours", "verdict", ""),
        ]
        lines += ["|" + "---|" * 6, *map(_statement_row, topic.statements)]
    lines += ["", "## Contradictions between thesis and model, and how each was settled", ""]
    lines += [_row("", "section", "thesis", "the model had", "settled", "how"), "|" + "---|" * 6]
    lines += [_settled_row(number, point) for number, point in enumerate(file.settled, start=1)]
    return "\n".join(lines) + "\n"


def _statement_row(one):
    sign = {"at least": "≥ ", "at most": "≤ ", "equal": ""}[one.compare]
    ours = (
        ""
        if one.our_value is None
        else f"{_with_unit(one.our_value, one.unit)} ({one.kind} `{one.source}`)"
    )
    published = sign + _with_unit(one.published, one.unit)
    return _row(one.section, one.says, published, ours, f"**{one.verdict}**", one.reason)


def _settled_row(number, point):
    about = f"{number}. {point.about}"
    settled = f"**{point.settled}**"
    return _row(about, point.section, point.thesis, point.had, settled, point.how)


def _with_unit(value, unit):
    if isinstance(value, bool):
        return "yes" if value else "no"
    return (
        value
        if isinstance(value, str)
        else f"{value:.5g}" + ("" if unit in ("", "1") else f" {unit}")
    )


def _row(*cells):
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"
