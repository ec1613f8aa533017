"""What a notebook shows live: frames that a stored notebook replaces by their line, sliders that
start as asked.
"""

import html
import sys
from functools import partial
from types import SimpleNamespace

import pytest

from aerodima.workbench import UserError, live_frame, sliders
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.view import captions, replay_page
from tests.refusals import assert_refused


class Meshcat:
    def web_url(self):
        return "http://localhost:7000?a=1&b=2"


def test_meshcat_stands_in_a_frame():
    frame = live_frame(Meshcat())
    assert 'src="http://localhost:7000?a=1&amp;b=2"' in frame._repr_html_()


def test_a_replay_stands_in_a_frame_whole_and_escaped(monkeypatch):
    page = '<p title="a & b">replay</p>'
    monkeypatch.setattr(replay_page, "replay_page", lambda run_log: page)
    monkeypatch.setattr(
        captions, "run_caption", lambda run_log: SimpleNamespace(text="turn: survived")
    )
    frame = live_frame(object.__new__(RunLog))
    inside = frame._repr_html_().partition('srcdoc="')[2].partition('"')[0]
    assert html.unescape(inside) == page
    assert "turn: survived" in repr(frame)


@pytest.mark.parametrize("height", [0, 99, 4001])
def test_a_frame_that_nobody_could_see_is_refused(height):
    work = partial(live_frame, Meshcat(), height)
    assert_refused(work, UserError, "height", str(height), "100", "4000")


def test_what_cannot_be_shown_is_named():
    work = partial(live_frame, "swing.parquet")
    assert_refused(work, UserError, "live_frame", "str")


def test_sliders_begin_where_they_are_told(monkeypatch):
    made = {}

    def slider(value, **settings):
        return {"value": value, **settings}

    widgets = SimpleNamespace(
        FloatSlider=slider, interact=lambda function, **given: made.update(given)
    )
    monkeypatch.setitem(sys.modules, "ipywidgets", widgets)
    sliders(print, friction=(0.5, 0.9, 0.6))
    assert made["friction"] == {
        "value": 0.6, "min": 0.5, "max": 0.9, "step": pytest.approx(0.02),
        "continuous_update": False
    }  # fmt: skip


def test_without_ipywidgets_the_function_is_called_once_and_a_line_says_why(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "ipywidgets", None)
    called = []
    sliders(lambda **values: called.append(values), friction=(0.5, 0.9, 0.6), speed=(1.0, 2.0, 1.5))
    assert called == [{"friction": 0.6, "speed": 1.5}]
    assert capsys.readouterr().out.count("\n") == 1


@pytest.mark.parametrize(
    "given", [(0.5, 0.9, 1.0), (0.9, 0.5, 0.6), (0.5, 0.5, 0.5), (0.5, 0.9, float("nan"))]
)
def test_a_start_outside_the_range_is_refused(given):
    assert_refused(lambda: sliders(print, friction=given), UserError, "sliders", "friction")
