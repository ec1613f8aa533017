"""The product stays within its one limit of size."""

from pathlib import Path

from tests.code_measure import MAX_NODES, product_nodes

ROOT = Path(__file__).resolve().parent.parent


def test_product_is_within_its_limit_of_nodes() -> None:
    assert product_nodes(ROOT) <= MAX_NODES
