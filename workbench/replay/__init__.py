"""Replays of run logs: in Meshcat, and as a strip of five pictures. Importing this loads Drake."""

from aerodima.workbench.replay.recording import record_run
from aerodima.workbench.replay.strip import write_strip
from aerodima.workbench.replay.viewer import open_meshcat

__all__ = ["open_meshcat", "record_run", "write_strip"]
