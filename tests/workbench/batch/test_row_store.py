"""Rows on the disk: kept through an interruption, for one process at a time, never taken for those
of other work.
"""

import json
from functools import partial
from types import SimpleNamespace

import pytest

from aerodima.workbench.batch.row_store import (
    ProgressBar,
    RowStore,
    content_key,
    print_resume_hint,
)
from aerodima.workbench.core.errors import UserError
from tests.refusals import assert_refused


def test_rows_are_there_again_but_for_the_line_that_was_cut_off(tmp_path):
    path = tmp_path / "work" / "rows.jsonl"
    with RowStore(path, {"speed": 4.5}) as store:
        store.add("a", {"roll": 0.25})
        store.add("b", {"roll": 0.5})
    path.write_bytes(path.read_bytes()[:-4])
    with RowStore(path, {"speed": 4.5}) as store:
        assert store.rows == {"a": {"roll": 0.25}}
        store.add("b", {"roll": 0.5})
    with RowStore(path, {"speed": 4.5}) as store:
        assert store.rows == {"a": {"roll": 0.25}, "b": {"roll": 0.5}}


@pytest.mark.parametrize("head", ['{"speed": 4.', '{"speed": 4.6}', '{"key": ["a"]}', "[" * 9999])
def test_a_damaged_line_costs_its_own_row_alone_also_the_first(tmp_path, head):
    path = tmp_path / "rows.jsonl"
    with RowStore(path, {"speed": 4.5}) as store:
        store.add("a", {"roll": 0.25})
    lines = path.read_text().splitlines()
    path.write_text("\n".join([head, *lines[1:], '{"key": ["b"], "roll": 1}', '{"key": 1}']))
    with RowStore(path, {"speed": 4.5}) as store:
        assert store.rows == {"a": {"roll": 0.25}}
    path.write_text("\n".join(lines[2:]))
    assert_refused(lambda: RowStore(path, {"speed": 4.5}), UserError, "head", "--force")


def test_a_full_disk_is_one_error_and_what_was_written_is_there_again(tmp_path):
    path = tmp_path / "rows.jsonl"
    with RowStore(path, {}) as store:
        store.add("a", {"roll": 0.25})
        store._stream.write(b'{"key": "b", "ro')
        store._stream = SimpleNamespace(write=lambda _: 0, close=store._stream.close)
        assert_refused(lambda: store.add("b", {}), UserError, str(path), "No space left")
    with RowStore(path, {}) as store:
        assert store.rows == {"a": {"roll": 0.25}}


def test_rows_of_other_work_are_refused_by_name_and_dropped_by_force(tmp_path):
    path = tmp_path / "rows.jsonl"
    with RowStore(path, {"speed": 4.5, "seed": 1}) as store:
        store.add("a", {})
    before = path.read_bytes()
    for other, named in (({"speed": 6.0, "seed": 1}, "speed"), ({"speed": 4.5}, "seed")):
        assert_refused(partial(RowStore, path, other), UserError, named)
    assert path.read_bytes() == before
    with RowStore(path, {"speed": 6.0}, force=True) as store:
        assert store.rows == {}


def test_a_second_process_is_refused_until_the_first_has_closed(tmp_path):
    path = tmp_path / "rows.jsonl"
    with RowStore(path, {}):
        assert_refused(lambda: RowStore(path, {}, force=True), UserError, str(tmp_path))
    RowStore(path, {}).close()


def test_a_folder_with_other_files_is_refused_where_the_work_wants_its_own(tmp_path):
    (tmp_path / "thesis.tex").touch()
    work = partial(RowStore, tmp_path / "rows.jsonl", {}, alone=True)
    assert_refused(work, UserError, "thesis.tex")
    assert not (tmp_path / "rows.jsonl").exists()
    RowStore(tmp_path / "rows.jsonl", {}, alone=True, force=True).close()
    RowStore(tmp_path / "rows.jsonl", {}, alone=True).close()


def test_the_key_follows_the_content_alone():
    assert content_key({"a": 1, "b": 2.0}, None) == content_key(
        json.loads('{"b": 2.0, "a": 1}'), None
    )
    assert len({content_key(1.0), content_key(1.0 + 2**-52), content_key(), content_key(None)}) == 4


def test_an_interruption_says_what_is_kept_and_how_to_go_on():
    said = []
    progress = ProgressBar(said.append, 4, there=1)

    def work():
        with print_resume_hint(said.append, lambda: f"{progress.done} of 4 runs"):
            progress.advance("survived")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        work()
    assert "2/4 survived" in said[0]
    assert "2 of 4 runs" in said[1]
