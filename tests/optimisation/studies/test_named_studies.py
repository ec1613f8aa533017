"""The studies that are built in, asked for by name."""

import pytest

from aerodima.optimisation.studies.named_studies import STUDIES, named_study
from aerodima.optimisation.sweep.study import Study, plan_runs
from aerodima.workbench.errors import UserError


@pytest.mark.parametrize("name", STUDIES)
def test_every_name_makes_a_study_with_runs_and_a_reader(name):
    study, read = named_study(name, ["car.com_height=0.21"])
    assert isinstance(study, Study)
    assert plan_runs(study)
    assert callable(read)


def test_what_a_study_alone_has_is_passed_on():
    sizes = [len(plan_runs(named_study("monte-carlo", samples=samples)[0])) for samples in (2, 4)]
    assert sizes[1] == 2 * sizes[0]


def test_an_unknown_name_lists_all():
    with pytest.raises(UserError, match="'tide': allowed: turn, tail, mount, trigger, shapes, monte-carlo"):
        named_study("tide")
