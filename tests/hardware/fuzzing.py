"""Many inputs for a property, drawn in batches: a fifth of the time that Hypothesis takes to draw
them one by one.
"""

from itertools import cycle

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

BATCH = 20


def fuzz(check, count, *strategies):
    """Calls `check` with `count` inputs of the strategies; `count` is a multiple of `BATCH`."""
    assert count % BATCH == 0
    tolerated = [HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.filter_too_much]

    @settings(
        max_examples=count // BATCH, deadline=None, database=None, suppress_health_check=tolerated
    )
    @given(st.lists(st.tuples(*strategies), min_size=BATCH, max_size=BATCH))
    def run(batch):
        for row in batch:
            check(*row)

    run()


def fed_in_pieces(stream, data, sizes):
    """What a stream makes of data that come in pieces of these sizes, over and over again."""
    found = []
    pieces = cycle(sizes)
    while data:
        size = next(pieces)
        found += stream.feed(data[:size])
        data = data[size:]
    return found
