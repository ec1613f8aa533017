"""Resting detection, drift, offsets, gaps, cuts; recipes and what is wrong in them."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
import pytest

from aerodima.workbench.errors import LogError
from aerodima.workbench.figures.conditioning_figure import changed_columns, plot_conditioning
from aerodima.workbench.logs.conditioning import (
    OFFSETS,
    WRENCH,
    add_offsets,
    cut,
    fill,
    filtered,
    keep_longest,
    published_offsets,
    rate_from_angle,
    remove_drift,
    resampled,
)
from aerodima.workbench.logs.recipe import apply_recipe, recipe_from
from aerodima.workbench.logs.schema import RunLog, run_log_from_metadata, run_metadata
from aerodima.workbench.logs.signals import RIG_FILTER_20_HZ, resting_parts
from tests.workbench.logs.foreign_logs import DRIFT, NOISE, RELEASED_AT, swing_readings, swing_truth

TIMES = np.arange(5001) / 500.0


def rig_log(
    signals: Mapping[str, Any] | None = None, time: np.ndarray = TIMES, kind: str = "swing", **extra: Any
) -> RunLog:
    table = pd.DataFrame({"time_s": time, "angle_rad": np.zeros(time.size), **(signals or {})})
    return run_log_from_metadata(table, run_metadata({}, 0, kind=kind, extra=extra), source="rig.parquet")


def recipe(*steps: dict[str, Any], **rest: Any):
    return recipe_from({"schema": "aerodima/log-recipe/1", "steps": list(steps), "rest": rest}, "r.yaml")


def test_a_tail_that_is_held_up_or_turns_around_is_not_at_rest() -> None:
    """Hangs until 2 s, is held at 1 rad until 6 s, swings and passes zero until 9 s, hangs again."""
    angle = np.select([TIMES < 2, TIMES < 6, TIMES < 9], [0.0, 1.0, np.cos(2 * np.pi * TIMES)], 0.0)
    parts = resting_parts(rig_log({"angle_rad": angle}), {"angle_rad": (-0.02, 0.02)})
    assert parts == [(0.0, pytest.approx(1.75, abs=0.11)), (pytest.approx(9.25, abs=0.11), 10.0)]
    assert resting_parts(rig_log({"angle_rad": angle}), {"angle_rad": (-0.02, 0.02)}, shortest=5.0) == []


def test_noise_is_not_motion() -> None:
    """Encoder steps in the rate are twice the limit; their mean over 0.1 s is not."""
    noise = 0.1 * (-1.0) ** np.arange(TIMES.size)
    assert resting_parts(rig_log({"w": noise}), {"w": (-0.05, 0.05)}) == [(0.0, 10.0)]


def test_drift_between_two_rests_is_removed_and_the_swing_is_kept() -> None:
    readings = swing_readings()
    run_log = rig_log({name: readings[name] for name in WRENCH}, readings["time_s"].to_numpy())
    done = remove_drift(run_log, WRENCH, [(0.0, 2.9), (20.0, 26.0)])
    truth = swing_truth(run_log.time)
    for name, noise, slope in zip(WRENCH, NOISE, DRIFT, strict=True):
        error = done.run_log.signal(name) - truth[name].to_numpy()
        # The line's error at either rest is noise / sqrt(1450 samples), and what is left of the swing at 20 s.
        assert np.sqrt(np.mean(error**2)) < 1.02 * noise, name
        assert abs(np.mean(error)) < 0.05 * noise, name
        stated = float(done.notes[WRENCH.index(name)].split(": ")[1].split(" per s")[0])
        assert stated == pytest.approx(slope, rel=0.02)


def test_drift_is_the_line_through_the_resting_part_only() -> None:
    pulse = np.where((TIMES > 5.0) & (TIMES < 6.0), 2.0, 0.0)
    run_log = rig_log({"force_y_n": pulse + 0.3 - 0.05 * TIMES})
    done = remove_drift(run_log, ["force_y_n"], [(0.0, 4.0)])
    np.testing.assert_allclose(done.run_log.signal("force_y_n"), pulse, atol=1e-12)
    with pytest.raises(LogError, match=r"no resting part .* force_y_n"):
        remove_drift(run_log, ["force_y_n"], [(20.0, 21.0)])
    lost = rig_log({"force_y_n": np.where(TIMES[42] == TIMES, np.nan, 0.0)})
    with pytest.raises(LogError, match=r"'force_y_n': 1 sample\(s\) not finite"):
        remove_drift(lost, ["force_y_n"], [(0.0, 4.0)])


def test_drift_with_the_wind_on_keeps_the_level() -> None:
    run_log = rig_log({"force_y_n": -2.5 + 0.1 * TIMES})
    kept = remove_drift(run_log, ["force_y_n"], [(0.0, 3.0)], level="keep").run_log
    assert np.allclose(kept.signal("force_y_n"), -2.5, atol=1e-12)
    assert np.allclose(remove_drift(run_log, ["force_y_n"], [(0.0, 3.0)]).run_log.signal("force_y_n"), 0.0, atol=1e-12)


def test_offsets_of_table_4_4_carry_the_weight_of_the_hanging_rig() -> None:
    """Support on the rig: Fz = +m g. 15.695 N is the published 1.6 kg of rig; a sign error would double it."""
    zeroed = {name: np.zeros(TIMES.size) for name in WRENCH}
    done = add_offsets(rig_log(zeroed, tail="1"))
    assert [done.run_log.signal(name)[0] for name in WRENCH] == [-0.064, -0.019, 15.695, -0.011, -0.538, 0.013]
    assert published_offsets("3")["torque_y_n_m"] == -0.523
    assert done.run_log.extra[OFFSETS] == [0.0] * 6


def test_a_log_that_states_its_offsets_gets_those() -> None:
    done = add_offsets(rig_log({"force_z_n": np.zeros(TIMES.size)}, tail="1", **{OFFSETS: [1, 2, 3, 4, 5, 6]}))
    assert done.run_log.signal("force_z_n")[0] == 3.0
    assert "the log has no force_x_n, force_y_n, torque_x_n_m" in done.notes[1]


def test_offsets_are_not_added_twice_and_need_a_tail_and_a_force() -> None:
    once = apply_recipe(rig_log({"force_z_n": np.zeros(TIMES.size)}, tail="2"), recipe({"step": "offsets"})).run_log
    assert once.signal("force_z_n")[0] == 15.689
    with pytest.raises(LogError, match=r"rig\.parquet: the offsets have been added to this log before"):
        apply_recipe(once, recipe({"step": "offsets"}))
    with pytest.raises(LogError, match=r"its metadata have no tail"):
        add_offsets(rig_log({"force_z_n": np.zeros(TIMES.size)}))
    with pytest.raises(LogError, match=r"tail 'robot': Table 4\.4 has offsets for the tails 1, 2, 3 only"):
        add_offsets(rig_log({"force_z_n": np.zeros(TIMES.size)}, tail="robot"))
    with pytest.raises(LogError, match=r"no force or torque column"):
        add_offsets(rig_log(tail="1"))


def holed() -> RunLog:
    """A straight line with a gap of 0.02 s after 2 s and NaN from 4 to 4.01 s; a state that changes in the gap."""
    lost = (TIMES > 2.0) & (TIMES < 2.02 - 1e-9)
    table = {"force_y_n": 3.0 * TIMES, "planned_turn": (TIMES > 2.01).astype(float)}
    table["force_y_n"] = np.where((TIMES >= 4.0) & (TIMES <= 4.01), np.nan, table["force_y_n"])
    return rig_log({name: values[~lost] for name, values in table.items()}, TIMES[~lost])


def test_fill_draws_straight_lines_and_holds_states() -> None:
    done = fill(holed(), 0.05)
    assert np.allclose(done.run_log.time, TIMES)
    assert np.allclose(done.run_log.signal("force_y_n"), 3.0 * TIMES)
    assert done.run_log.signal("planned_turn")[(TIMES > 2.0) & (TIMES < 2.019)].tolist() == [0.0] * 9
    assert done.notes == (
        "gap of 0.02 s at 2 s filled with 9 rows",
        "6 lost sample(s) of force_y_n filled, the first at 4 s",
    )


def test_fill_refuses_what_is_too_long_or_at_an_end() -> None:
    with pytest.raises(LogError, match=r"rig\.parquet: column 'time_s': 1 gap\(s\), the first of 0\.02 s after 2 s"):
        fill(holed(), 0.015)
    lost = rig_log({"force_y_n": np.where((TIMES > 4) & (TIMES < 5), np.nan, 1.0)})
    with pytest.raises(LogError, match=r"column 'force_y_n': no numbers for 1 s after 4 s; at most 0\.5 s is filled"):
        fill(lost, 0.5)
    with pytest.raises(LogError, match=r"column 'force_y_n': not a number at 0 s, with no sample on both sides"):
        fill(rig_log({"force_y_n": np.where(TIMES < 1, np.nan, 1.0)}), 5.0)


def test_keep_longest_keeps_the_longest_piece() -> None:
    done = keep_longest(holed())
    assert (done.run_log.time[0], done.run_log.time[-1]) == (4.012, 10.0)
    whole = rig_log()
    assert keep_longest(whole).run_log is whole


def test_cut_and_resample_and_differentiate() -> None:
    run_log = rig_log({"angle_rad": np.sin(TIMES), "status_imu_fault": np.floor(TIMES)})
    part = cut(run_log, 2.0, 4.0, restart_time=True)
    assert part.time_shift == 2.0
    assert (part.run_log.time[0], part.run_log.time[-1], len(part.run_log.table)) == (0.0, pytest.approx(2.0), 1001)
    assert part.run_log.signal("angle_rad")[0] == np.sin(2.0)
    fine = resampled(run_log, 750.0).run_log
    assert np.allclose(fine.signal("angle_rad"), np.sin(fine.time), atol=1e-6)
    assert np.array_equal(np.unique(fine.signal("status_imu_fault")), np.arange(11.0)), "states are not interpolated"
    assert "folded" in resampled(run_log, 100.0).notes[1]
    rate = rate_from_angle(run_log, "angle_rad", "angular_velocity_rad_per_s").run_log
    assert np.allclose(rate.signal("angular_velocity_rad_per_s")[1:-1], np.cos(TIMES)[1:-1], atol=1e-6)
    with pytest.raises(LogError, match=r"20 to 30 s leaves nothing of 0 to 10 s"):
        cut(run_log, 20.0, 30.0)


def test_a_stated_rest_moves_with_the_times_of_the_log() -> None:
    run_log = rig_log(rest_s=[0.0, 2.0])
    assert cut(run_log, 0.5, 4.0).run_log.extra["rest_s"] == [0.0, 2.0]
    part = cut(run_log, 0.5, 4.0, restart_time=True).run_log
    assert part.extra["rest_s"] == [-0.5, 1.5]
    assert "rest_s" not in cut(rig_log(), 0.5, 4.0, restart_time=True).run_log.extra
    for wrong in (1.0, [1.0], ["a", "b"], [None, 1.0]):
        with pytest.raises(LogError, match=r"rig\.parquet: metadata 'rest_s' is .*; 2 numbers are needed"):
            cut(rig_log(rest_s=wrong), 0.5, 4.0, restart_time=True)


def test_a_filter_shifts_nothing_and_takes_the_mains_out() -> None:
    clean = np.sin(2 * np.pi * 0.5 * TIMES)
    done = filtered(
        rig_log({"force_y_n": clean + 0.3 * np.sin(2 * np.pi * 50 * TIMES)}), ["force_y_n"], RIG_FILTER_20_HZ
    )
    middle = (TIMES > 1) & (TIMES < 9)
    assert np.max(np.abs(done.run_log.signal("force_y_n") - clean)[middle]) < 1e-4


@pytest.mark.parametrize(
    ("run_log", "message"),
    [
        (rig_log({"force_y_n": 0.0}, TIMES[:3]), r"column 'force_y_n': 3 samples are too few .* \(step 1, filter\)"),
        (rig_log({"force_y_n": np.nan}), r"column 'force_y_n': 5001 sample\(s\) not finite, first nan at 0 s \(step 1"),
        (rig_log({"force_y_n": 0.0}, TIMES[::-1].copy()), r"not increasing in row 1, 9\.998 s after 10 s \(step 1"),
        (rig_log(), r"none of the columns force_y_n is there \(step 1"),
        (holed(), r"column 'time_s': 1 gap\(s\), the first of 0\.02 s after 2 s"),
    ],
)
def test_a_step_that_cannot_be_done_names_column_time_and_step(run_log: RunLog, message: str) -> None:
    with pytest.raises(LogError, match=message):
        apply_recipe(run_log, recipe({"step": "filter", "columns": ["force_y_n"], "design": "rig_20_hz"}))


def test_a_constant_signal_is_filtered_to_itself() -> None:
    done = apply_recipe(
        rig_log({"force_y_n": 2.0}), recipe({"step": "filter", "columns": ["force_*"], "order": 2, "cutoff_hz": 5})
    )
    assert np.allclose(done.run_log.signal("force_y_n"), 2.0, atol=1e-12)


def test_a_log_without_rest_says_what_to_do() -> None:
    moving = rig_log({"force_y_n": 0.0, "angular_velocity_rad_per_s": 1.0})
    drift = {"step": "drift", "columns": ["force_*"]}
    with pytest.raises(
        LogError, match=r"no resting part: nowhere angular_velocity_rad_per_s in \[-0\.02, 0\.02\], .*parts"
    ):
        apply_recipe(moving, recipe(drift))
    assert apply_recipe(moving, recipe(drift, parts=[[0, 1]])).rest == ((0.0, 1.0),)


def test_what_a_log_has_not_is_said_and_the_rest_done() -> None:
    steps = {"step": "drift", "columns": ["force_x_n", "force_y_n"]}
    done = apply_recipe(rig_log({"force_y_n": 1.0 + TIMES}), recipe(steps, parts=[[0, 1]]))
    assert "drift: the log has no force_x_n" in done.notes
    assert np.allclose(done.run_log.signal("force_y_n"), 0.0, atol=1e-9)
    with pytest.raises(LogError, match=r"no column 'forse_y_n'; did you mean 'force_y_n'"):
        apply_recipe(rig_log({"force_y_n": 0.0}), recipe({"step": "drift", "columns": ["forse_y_n"]}, parts=[[0, 1]]))


def test_a_gap_that_no_step_deals_with_is_refused_at_the_end() -> None:
    with pytest.raises(LogError, match=r"after all steps: column 'time_s': 1 gap.*add a step `fill` or `keep_longest`"):
        apply_recipe(holed(), recipe({"step": "cut", "from_s": 0.0}))


def test_cut_to_motion_finds_the_swing_and_the_log_remembers_what_was_done() -> None:
    readings = swing_readings()
    run_log = rig_log({"angle_rad": readings["angle_rad"]}, readings["time_s"].to_numpy())
    steps = [{"step": "fill", "longest_s": 0.1}, {"step": "cut_to_motion", "restart_time": True}]
    done = apply_recipe(run_log, recipe(*steps, within={"angle_rad": [-0.01, 0.01]}))
    entry = done.run_log.extra["conditioning"][0]
    assert entry["recipe"]["steps"][0] == {"step": "fill", "longest_s": 0.1}
    assert entry["time_shift_s"] == pytest.approx(2.7, abs=0.15), "lifted from 3 s on"
    # exp(-0.7 t) pi/2 = 0.01 at 7.2 s after the release; 0.4 s of margins and rest after it.
    assert done.run_log.time[-1] + entry["time_shift_s"] == pytest.approx(RELEASED_AT + 7.2 + 0.4, abs=0.6)


@pytest.mark.parametrize(
    ("steps", "message"),
    [
        ([{"step": "smooth"}], r"r\.yaml: steps\.0: .*'smooth'.*'differentiate'$"),
        ([{"step": "resample", "rate_hz": 1e12}], r"rate_hz: 1000000000000\.0 is not allowed; .* equal to 100000$"),
        ([{"step": "fill"}], r"r\.yaml: steps\.0\.fill\.longest_s: missing"),
        ([{"step": "fill", "longest": 1}], r"steps\.0\.fill\.longest: unknown key; did you mean 'longest_s'"),
        ([{"step": "filter", "columns": ["a"]}], r"steps\.0\.filter: needs `design`, or `order` and `cutoff_hz`"),
        (
            [{"step": "filter", "columns": ["a"], "design": "x"}],
            r"steps\.0\.filter\.design: 'x' is not allowed; .*'imu'",
        ),
        ([{"step": "resample", "rate_hz": -1}], r"steps\.0\.resample\.rate_hz: -1 is not allowed; .* greater than 0"),
        ([], r"r\.yaml: steps: "),
    ],
)
def test_a_wrong_recipe_is_one_line_that_names_step_and_key(steps: list[dict[str, Any]], message: str) -> None:
    with pytest.raises(LogError, match=message) as caught:
        recipe(*steps)
    assert "\n" not in str(caught.value)


def test_an_empty_list_of_resting_parts_is_refused() -> None:
    with pytest.raises(LogError, match=r"r\.yaml: rest\.parts: "):
        recipe({"step": "cut_to_motion"}, parts=[])


@pytest.mark.parametrize("wrong", [[1.0, 2.0], "x", [None] * 6])
def test_offsets_that_are_not_six_numbers_are_named(wrong: object) -> None:
    run_log = rig_log({"force_y_n": np.zeros(TIMES.size)}, **{OFFSETS: wrong})
    with pytest.raises(LogError, match=r"rig\.parquet: metadata 'offsets_to_add' is .*; 6 numbers are needed"):
        add_offsets(run_log)


def test_the_plot_shows_the_changed_columns_with_their_rests_and_gaps() -> None:
    before = holed()
    done = apply_recipe(
        before, recipe({"step": "fill", "longest_s": 0.1}, {"step": "drift", "columns": ["force_*"]}, parts=[[0, 1]])
    )
    assert changed_columns(before, done.run_log) == ["force_y_n"]
    figure = plot_conditioning(before, done.run_log, done.rest)
    (axes,) = figure.axes
    assert axes.get_ylabel() == "force_y_n"
    lines = {line.get_label(): line for line in axes.get_lines()}
    assert np.allclose(lines["after"].get_ydata(), 0.0, atol=1e-9)
    assert np.nanmax(lines["before"].get_ydata()) == 30.0
    assert {patch.get_label() for patch in axes.patches} == {"at rest", "gap"}
