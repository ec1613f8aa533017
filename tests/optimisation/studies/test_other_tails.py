"""Other people's tails: the table of published figures, verdicts, the page beside it, the map."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from pydrake.multibody.tree import SpatialInertia
from scipy.integrate import trapezoid
from typer.testing import CliRunner

from aerodima.optimisation.studies import other_tails
from aerodima.optimisation.studies.other_tail_systems import ROLL, SYSTEMS, Measured, exponent
from aerodima.optimisation.studies.other_tails import (
    MEASURES,
    TailFigure,
    document_rows,
    measure_all,
    summary,
    tail_figures,
    verdict_on,
    write_other_tails,
)
from aerodima.optimisation.studies.tail_map import Tail, air_impulse, even_tail, known_tails
from aerodima.optimisation.studies.tailed_body import Swing, TailAir, TailedBody, at, swing_tail
from aerodima.workbench.aero.sections import Air, SectionLayout
from aerodima.workbench.cli.program import build_app
from aerodima.workbench.config.scenario_file import load_parameter_file
from aerodima.workbench.errors import UserError
from aerodima.workbench.resources import model_path, published_rows

DOCUMENT = Path(__file__).resolve().parents[3] / "docs" / "other_tails.md"


QUICK = [system for system in SYSTEMS if system != "Minitaur's drag tail"]
"""What is simulated within a second."""


def published() -> dict[str, Measured]:
    return {row["id"]: Measured(float(row["published"])) for row in published_rows("other_tails") if row["id"]}


@pytest.fixture(scope="module")
def quick() -> list[TailFigure]:
    """The figures of the quick systems, measured."""
    found = published()
    for system in QUICK:
        found |= SYSTEMS[system]()
    return [figure for figure in tail_figures(found) if figure.system in QUICK]


@pytest.mark.slow
def test_every_row_of_the_page_is_what_a_run_gives() -> None:
    text = DOCUMENT.read_text(encoding="utf-8")
    figures = tail_figures(measure_all())
    missing = [row for row in document_rows(figures) if row not in text]
    assert not missing
    assert summary(figures) in " ".join(text.split())
    reproduced = [f for f in figures if f.row.verdict == "reproduced" and f.row.basis == "prediction"]
    assert len(reproduced) == 15
    assert sum(figure.simulated for figure in reproduced) == 9


def test_rows_of_quick_systems_are_what_a_run_gives(quick: list[TailFigure]) -> None:
    text = DOCUMENT.read_text(encoding="utf-8")
    rows = list(document_rows(quick))
    assert len(rows) == 15
    assert not [row for row in rows if row not in text]


def test_published_figures_and_sources_of_the_page_are_those_of_the_table() -> None:
    text = DOCUMENT.read_text(encoding="utf-8")
    rows = [row for row in published_rows("other_tails") if row["id"]]
    for row in rows:
        unit = "" if row["unit"] == "1" else f" {row['unit']}"
        assert f"| {row['system']}: {row['claim']} | {float(row['published']):g}{unit} |" in text
        assert row["source"]
        assert row["read_in"]
        assert row["note"]
    assert len(rows) == 22


def test_what_could_not_be_held_stands_on_the_page() -> None:
    text = " ".join(DOCUMENT.read_text(encoding="utf-8").split())
    for row in published_rows("other_tails"):
        if not row["id"]:
            assert row["claim"] in text
            assert row["missing"] in text


def test_every_parameter_has_unit_and_source() -> None:
    files = sorted(model_path("other_tails").glob("*.yaml"))
    assert len(files) == len(SYSTEMS)
    for file in files:
        assert load_parameter_file(file)


@pytest.mark.parametrize(
    ("published", "ours", "change", "verdict"),
    [
        (10.0, Measured(10.9), False, "reproduced"),
        (10.0, Measured(11.1), False, "not reproduced"),
        (10.0, Measured(10.1, 6.0, 12.0), False, "not reproduced"),  # the band would meet anything
        (10.0, Measured(10.1, 8.0, 12.0), False, "reproduced"),
        (40.0, Measured(10.0), True, "direction only"),
        (40.0, Measured(-10.0), True, "not reproduced"),
        (-2.0, Measured(2.0), False, "not reproduced"),
    ],
)
def test_verdicts(published: float, ours: Measured, change: bool, verdict: str) -> None:
    assert verdict_on(published, ours, 0.1 * abs(published), change=change) == verdict


def test_an_exponent_is_found() -> None:
    assert exponent(lambda size: 3.0 * size**-2.5).value == pytest.approx(-2.5, rel=1e-12)


def test_a_figure_without_its_other_side_is_named() -> None:
    told = published()
    told.pop("gecko_roll")
    with pytest.raises(UserError, match=r"other_tails\.csv: gecko_roll"):
        tail_figures(told)


def test_page_and_table_are_written_and_not_overwritten(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(other_tails, "MEASURES", {"all": published})
    done = CliRunner().invoke(build_app(), ["other-tails", "--out", str(tmp_path)])
    assert done.exit_code == 0, done.output
    table = pd.read_csv(tmp_path / "other_tails.csv")
    assert list(table.error_percent.dropna().unique()) == [0.0]
    assert (table.verdict == "reproduced").sum() == len(published())
    page = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert "Inertia and air over size and speed" in page
    assert (tmp_path / "other_tails_map.png").stat().st_size > 10_000
    with pytest.raises(UserError, match=r"other_tails\.csv: exists"):
        write_other_tails(tmp_path)
    with pytest.raises(UserError, match=r"cannot be made"):
        write_other_tails(tmp_path / "index.html" / "below")


def test_systems_have_names_of_the_table() -> None:
    assert set(MEASURES) <= {row["system"] for row in published_rows("other_tails")}


def test_the_map_has_both_limits() -> None:
    """An even strip: 3/8 Phi rho C L / s in still air, 1/2 Phi (rho C L / s) U / (w L) in fast air."""
    number = 0.4
    still, fast = even_tail(0.5, 1e-9, air_over_mass=number), even_tail(0.5, 400.0, air_over_mass=number)
    assert still.ratio == pytest.approx(3.0 / 8.0 * math.pi / 2.0 * number, rel=3e-3)  # 20 sections
    assert fast.ratio == pytest.approx(0.5 * math.pi / 2.0 * number * fast.speed_ratio, rel=3e-3)
    assert still.air_over_mass == pytest.approx(number, rel=1e-12)
    lighter = even_tail(0.5, 3.0, air_over_mass=1e6)
    heavier = even_tail(0.5, 3.0, air_over_mass=1e-6)
    assert heavier.ratio < 1e-5 < 1e5 < lighter.ratio


def test_every_even_strip_lies_on_one_map() -> None:
    small = even_tail(0.1, 1.0, air_over_mass=0.3, rate=10.0)
    large = even_tail(1.0, 4.0, air_over_mass=0.3, rate=4.0)
    assert small.speed_ratio == pytest.approx(large.speed_ratio)
    assert small.ratio == pytest.approx(large.ratio, rel=1e-9)


def test_the_impulse_of_the_map_is_that_of_a_simulated_swing() -> None:
    """Of the same strip at the same mean square rate over the same time."""
    layout = SectionLayout.strip(start=0.1, length=0.4, width=0.1, number=20, normal_B=(0.0, 1.0, 0.0))
    stick = at(SpatialInertia.SolidBoxWithMass(0.1, 0.01, 0.01, 0.5), (0.0, 0.0, 0.25))
    body = TailedBody(SpatialInertia.SolidSphereWithMass(1.0, 0.1), stick, (0.0, 0.0, 0.0), ROLL)
    moved = swing_tail(body, Swing(0.0, 1.0, 1.0), TailAir(layout, 2.0), held=True)
    squared = float(trapezoid(np.gradient(moved.tail, moved.time) ** 2, moved.time))
    tail = Tail("", 0.5, 0.1, 0.1, 0.01, 2.0, squared, 0.0, "")
    assert -moved.air_impulse == pytest.approx(air_impulse(tail, 1.0), rel=1e-3)


def test_the_known_tails_are_where_their_data_put_them() -> None:
    built, designed, cheetah, *_ = known_tails()
    assert built.ratio < 0.2 < designed.ratio
    assert cheetah.length == 0.39
    assert designed.air_over_mass == pytest.approx(Air().density * 2.0 * 0.9 / designed.areal_mass)
