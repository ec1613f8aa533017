"""`aerodima run`: what it prints, writes and refuses."""

import pytest

from aerodima.workbench.logs.schema import read_run_log
from aerodima.workbench.view.captions import run_caption
from tests.certain_cars import HIGH_CAR
from tests.commands import SHORT, done
from tests.refusals import assert_named


def test_turn_writes_the_log_it_was_asked_for(tmp_path):
    log = tmp_path / "new folder" / "run.parquet"
    words = "run turn_swing --speed 1.5 --tail held --direction right"
    assert_named(done(*words.split(), *SHORT, "--out", log), ("survived", str(log)))
    run = read_run_log(log)
    assert run.scenario["manoeuvre"]["speed"] == 1.5
    assert run.scenario["tail"]["mode"] == "held"
    # To the right is negative, and the tail stands on the inside.
    assert min(run.signal("steering_command_rad")) == pytest.approx(-0.5236, abs=1e-4)
    assert run.signal("tail_roll_angle_rad")[0] == pytest.approx(1.5708, abs=1e-3)


def test_law_of_a_file_drives_the_tail_and_is_named_in_log_and_caption(tmp_path):
    own = tmp_path / "my_law.py"
    log = tmp_path / "run.parquet"
    own.write_text(
        "import numpy as np\n\n\nclass Upright:\n    rate = 100.0\n    memory_size = 0\n\n"
        "    def start(self):\n        return np.zeros(0)\n\n    def step(self, memory, "
        "observation):\n"
        "        return memory, np.array([0.0, 0.0, 17.0, 5.0, 0.0]), np.array([0.3, 0.0, 17.0, "
        "5.0, 0.0]), 1\n"
    )
    done("run", "turn_swing", "--speed", 1.0, *SHORT, "--law", f"{own}:Upright", "--out", log)
    run = read_run_log(log)
    assert run.extra["tail_law"] == "Upright"
    assert run.table["tail_roll_command_position_rad"].iloc[-1] == 0.3
    assert "Upright" in run_caption(run).facts


@pytest.mark.parametrize(
    ("returned", "said"),
    [
        ("memory, command, command", ["ValueError", "4"]),
        (
            "memory, command[:4], command, 1",
            ["pitch command", "[0.0, 0.0, 0.0, 0.0]", "5"],
        ),
        (
            "memory, command, command * float('nan'), 1",
            ["0 s", "roll command", "nan", "5"],
        ),
        ("memory, command, observation.yawrate, 1", ["'yawrate'", "my_law.py", "line 9"]),
    ],
)
def test_law_that_fails_is_named_in_one_line_after_its_own_traceback(
    call, tmp_path, returned, said
):
    own = tmp_path / "my_law.py"
    own.write_text(
        "import numpy as np\n\nclass Mine:\n    rate, memory_size = 100.0, 0\n    def "
        "start(self):\n"
        "        return np.zeros(0)\n    def step(self, memory, observation):\n        command = "
        "np.zeros(5)\n"
        f"        return {returned}\n"
    )
    result = call("run", "turn_swing", *SHORT, "--law", f"{own}:Mine")
    assert result.exit_code == 2
    assert_named(result.stderr.splitlines()[-1], said)
    assert "simulation.py" not in result.stderr


@pytest.mark.slow
def test_tail_that_never_swung_is_noted(call):
    steered = (["--set", f"manoeuvre.steer_angle={angle}"] for angle in (0.05, 0.5))
    little, far = (
        call("run", "turn_swing", "--speed", 1.5, *SHORT, *settings).stdout for settings in steered
    )
    assert "note" in little
    assert "note" not in far


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (("--speed", "nan"), ("manoeuvre.speed", "nan")),
        (("--speed", "-1"), ("manoeuvre.speed", "-1", "0", "m/s")),
        (
            ("--tail", "wagging"),
            ("--tail wagging", "none, held, swing"),
        ),
        (("turn_swin",), ("turn_swin", "'turn_swing'")),
        (("--law", "nowhere.py:Law"), ("nowhere.py",)),
        (("--law", "nowhere.py:Law", "--tail", "none"), ("--law",)),
        (("--law", "nowhere.py:Law", "--swing", "thesis_8_rad_per_s"), ("--law", "--swing")),
        (("--set", "nonsense"), ("nonsense", "section.key=value")),
        (("--set", "imu.rate=2000"), ("imu.rate", "2000 Hz", "1/step", "500 Hz")),
        (("nowhere.yaml",), ("nowhere.yaml",)),
    ],
)
def test_wrong_input_is_one_clear_line(refused, words, named):
    scenario = ["turn_swing"] * words[0].startswith("-")
    assert_named(refused("run", *scenario, *SHORT, *words), named)


@pytest.mark.parametrize(("option", "allowed"), [("--out", ".parquet"), ("--html", ".html")])
def test_file_of_another_kind_is_refused(refused, tmp_path, option, allowed):
    message = refused("run", "turn_swing", *SHORT, option, tmp_path / "run.csv")
    assert_named(message, (option, "run.csv", "'.csv'", allowed))
    assert not list(tmp_path.iterdir())


def test_run_without_scenario_or_swing_says_what_is_missing(refused):
    assert "scenarios list" in refused("run", "--speed", 3)
    names = [line.split()[0] for line in done("scenarios", "list").splitlines() if line]
    assert {"turn_swing", "straight", "slalom", "static"} <= set(names)


def test_run_that_ends_before_its_turn_names_the_duration(refused):
    message = refused("run", "turn_swing", "--set", "manoeuvre.duration=1")
    assert_named(message, ("manoeuvre.duration", "1 s", "2.6"))


@pytest.mark.slow
def test_slalom_of_the_thesis_stays_upright_while_it_gathers_speed_and_rolls_over_at_4_m_per_s():
    """The thesis steers while it accelerates (6.1.3), and shows the first second of it."""
    assert "outcome: survived, clean" in done("run", "slalom")
    flags = [word for setting in HIGH_CAR for word in ("--set", setting)]
    assert "outcome: flipped" in done("run", "slalom", *flags, "--set", "manoeuvre.duration=6")
