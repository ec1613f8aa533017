"""Commands that write a file: one that is there is kept, unless `--force`."""

import pytest

from tests.commands import done


@pytest.mark.parametrize(
    ("words", "ending"),
    [
        ("run straight --set manoeuvre.duration=0.1 --out", ".parquet"),
        ("run straight --set manoeuvre.duration=0.1 --html", ".html"),
        ("rig static --duration 0.1 --out", ".parquet"),
        ("log metrics {log} --out", ".csv"),
        ("models export turn_none --out", ".json"),
        ("models coefficients plot robot_tail_weighted_average --out", ".png"),
    ],
)
def test_an_existing_file_is_kept_without_force(refused, tailless, untouched, words, ending):
    kept = untouched.rename(untouched.with_suffix(ending))
    command = (*words.format(log=tailless.source).split(), kept)
    assert "--force" in refused(*command)
    assert kept.read_text() == "precious"
    assert list(kept.parent.iterdir()) == [kept]
    done(*command, "--force")
    assert kept.read_bytes() != b"precious"
