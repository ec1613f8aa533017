"""A headless Chromium that reaches nothing but this machine; without one the tests here are
skipped.
"""

import shutil

import pytest

from tests.browser.console_session import BROWSERS, FLAGS


@pytest.fixture(scope="session")
def browser():
    executable = next((path for name in BROWSERS if (path := shutil.which(name))), None)
    if executable is None:
        pytest.skip(f"no browser on the path: {', '.join(BROWSERS)}")
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with api.sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=executable, args=list(FLAGS))
        yield started
        started.close()


@pytest.fixture
def failures():
    """What scripts on the page failed with."""
    return []


@pytest.fixture
def page(browser, failures):
    """A page that fails the test when a script on it fails."""
    context = browser.new_context(viewport={"width": 560, "height": 360})
    opened = context.new_page()
    opened.on("pageerror", lambda error: failures.append(str(error)))
    yield opened
    context.close()
    assert failures == []
