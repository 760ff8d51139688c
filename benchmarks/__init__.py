"""Benchmarks: figures that are measured, not asserted in timed tests."""
