"""The rig that a user names for a log."""

import pytest

from aerodima.optimisation.identify.fit_options import FitOptions
from aerodima.optimisation.identify.log_rig import named_rig, rig_of
from aerodima.optimisation.identify.rig_constants import shifted
from aerodima.workbench.core.errors import ScenarioError
from aerodima.workbench.rig.pendulum import PendulumModel
from tests.optimisation.identify import other_lab as lab
from tests.refusals import assert_refused


def test_a_rig_file_has_what_its_base_says_and_is_read_again_when_it_changes(tmp_path):
    log = lab.bar_swing(duration=0.2)
    base, above = tmp_path / "base.yaml", tmp_path / "rig.yaml"
    above.write_text("base: base.yaml\nmaxon: {torque_constant: 0.4}\n")
    for mass in (0.31, 0.32):
        base.write_text(f"bar: {{mass: {mass}}}\nmaxon: {{torque_constant: 0.3}}\n")
        rig = rig_of(log, "bar_swing", FitOptions(rig=str(above)))
        assert (rig.bar.mass, rig.maxon.torque_constant) == (mass, 0.4)


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("schema: aerodima/rig-scenario/2", ("rig-scenario/2", "rig-scenario/1")),
        ("maxon: {torqe_constant: 0.4}", ("maxon.torqe_constant", "'torque_constant'")),
    ],
)
def test_a_wrong_rig_file_is_refused_by_its_name(tmp_path, text, named):
    path = tmp_path / "rig.yaml"
    path.write_text(text)
    assert_refused(lambda: named_rig(str(path), ()), ScenarioError, "rig.yaml", *named)


@pytest.mark.parametrize("shift", [1e-4, -1e-4])
def test_a_bar_of_five_standard_deviations_more_inertia_can_still_be_built(shift):
    """Both moments across a slender bar are off together, or no body would have them."""
    rig = rig_of(lab.bar_swing(duration=0.2), "bar_swing", FitOptions())
    one, other = (
        PendulumModel.from_scenario(here) for here in (rig, shifted(rig, {"bar_inertia": shift}))
    )
    assert other.total_inertia(0.0) - one.total_inertia(0.0) == pytest.approx(shift)
