"""Old names warn and do what the new ones do."""

import pytest

from aerodima.workbench.core.deprecation import renamed


def double(number):
    return 2 * number


def test_an_old_name_warns_with_the_new_one_and_does_the_same():
    with pytest.warns(DeprecationWarning, match="old is now double"):
        assert renamed("old", double)(2) == 4
