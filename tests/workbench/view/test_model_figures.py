"""The block diagram as a picture: Graphviz draws it, a line stands for it where Graphviz is
missing.
"""

import shutil

import pytest
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, Gain

from aerodima.workbench import UserError, draw_diagram
from aerodima.workbench.view.model_figures import DiagramPicture
from tests.refusals import assert_refused

needs_graphviz = pytest.mark.skipif(shutil.which("dot") is None, reason="Graphviz is not installed")


@pytest.fixture
def diagram():
    builder = DiagramBuilder()
    source = builder.AddSystem(ConstantVectorSource([1.0]))
    gain = builder.AddSystem(Gain(2.0, 1))
    source.set_name("wind")
    gain.set_name("tail")
    builder.Connect(source.get_output_port(), gain.get_input_port())
    return builder.Build()


@needs_graphviz
def test_a_notebook_shows_the_systems_by_name(diagram):
    drawn = draw_diagram(diagram)._repr_svg_()
    assert "name=wind" in drawn
    assert "name=tail" in drawn


@needs_graphviz
def test_a_text_that_graphviz_refuses_is_an_error():
    assert_refused(lambda: DiagramPicture("digraph {").render("png"), UserError, "syntax error")


def test_without_graphviz_nothing_is_drawn(diagram, monkeypatch):
    monkeypatch.setattr(shutil, "which", lambda program: None)
    picture = draw_diagram(diagram)
    assert picture._repr_svg_() is None
    assert "Graphviz" in repr(picture)
    assert_refused(picture.render, UserError, "aerodima doctor")


def test_a_diagram_cannot_be_opened_less_than_one_level(diagram):
    assert_refused(lambda: draw_diagram(diagram, 0), UserError, "depth", "0", "1")
