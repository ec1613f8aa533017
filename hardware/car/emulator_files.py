"""Names of the files that an emulator makes, and how its ports are told from those of real devices."""

from __future__ import annotations

import json
import os
from pathlib import Path

READY_FILE = "ready.json"
"""Is there once an emulated car answers."""
PORTS_FILE = "ports.json"
"""The ports of an emulated car, for `connect` and `aerodima drive --ports`."""
EVENTS_FILE = "events.jsonl"
"""What happened in an emulated car, for `read_events`."""
TRAFFIC_FILE, TRUTH_FILE = "traffic.blf", "truth.parquet"
PORTS_FOLDER = "ports"
READY_SCHEMA = "aerodima/emulator/1"


def is_emulated_port(path: str) -> bool:
    """Whether a device is a pseudo-terminal that an emulator made.

    A pseudo-terminal alone is no proof: other programs put real devices behind one.
    """
    place = Path(path)
    if place.parent.name != PORTS_FOLDER or not os.path.realpath(path).startswith("/dev/pts/"):
        return False
    try:
        ready = json.loads((place.parent.parent / READY_FILE).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    return isinstance(ready, dict) and ready.get("schema") == READY_SCHEMA
