"""Bytes of the car's links as pure functions: no ports, no threads, no clocks, no Drake."""
