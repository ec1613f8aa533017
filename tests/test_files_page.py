"""The page of files has every key of their schemas."""

import re

import pytest

from aerodima.optimisation.studies.study import Block, Normal, Range, Sample, Study, Uniform
from aerodima.optimisation.swerve.candidate import CandidateList, ListedCandidate
from aerodima.workbench.scenario.swing_file import (
    GainPhase,
    Gains,
    JointGains,
    Knots,
    Limits,
    Provenance,
    SwingFile,
    Trigger,
)
from tests.code_measure import ROOT

CHAPTERS = dict(
    re.findall(
        r"^## (\w+)\n(.*?)(?=^## |\Z)",
        (ROOT / "docs" / "files.md").read_text(encoding="utf-8"),
        re.MULTILINE | re.DOTALL,
    )
)
SCHEMAS = {
    "Studies": (Study, Block, Range, Sample, Uniform, Normal),
    "Candidates": (CandidateList, ListedCandidate),
    "Swings": (SwingFile, Trigger, Knots, Gains, GainPhase, JointGains, Limits, Provenance),
}


@pytest.mark.parametrize("chapter", SCHEMAS)
def test_every_key_of_the_schemas_is_named(chapter):
    named = set(re.findall(r"`(\w+)`", CHAPTERS[chapter]))
    fields = (schema.model_fields.items() for schema in SCHEMAS[chapter])
    assert {field.alias or name for items in fields for name, field in items} <= named
