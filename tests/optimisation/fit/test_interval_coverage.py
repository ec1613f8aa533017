"""Coverage of intervals on logs that a campaign on the rig makes, and what the command says without any."""

from functools import partial
from pathlib import Path

import pytest

from aerodima.optimisation.fit.fit_batch import fit_logs
from aerodima.optimisation.fit.fit_errors import FitError
from aerodima.optimisation.fit.interval_coverage import coverage
from aerodima.optimisation.identify.log_fits import fit_static_log
from aerodima.workbench.config.rig_campaign import campaign_tasks, load_campaign
from aerodima.workbench.simulate.campaign_run import run_campaign


@pytest.mark.slow
def test_intervals_of_a_static_campaign_hold_the_truth(tmp_path: Path) -> None:
    tasks = campaign_tasks(load_campaign("static"), seed=5, repeats=1, settings=["experiment.duration=4.0"])
    logs = run_campaign(tasks, tmp_path / "logs", workers=1).logs
    fit_logs(partial(fit_static_log), logs, tmp_path / "fits", settings={})
    table = coverage(tmp_path / "fits").set_index("parameter")
    # 18 of 108 holds stand at 75 degrees, out of the jet: only their current is known.
    assert table.identifiable.to_dict() == {"cd": 90, "cl": 90, "psi3": 90, "current": 108, "all": 378}
    # Of 378 intervals, bound together by their logs, the share scatters by about 1.5 %.
    assert 0.91 <= table.coverage["all"] <= 0.985
    assert 0.8 <= table.score_deviation["all"] <= 1.2


def test_a_folder_without_fits_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FitError, match="holds no finished fits"):
        coverage(tmp_path)
