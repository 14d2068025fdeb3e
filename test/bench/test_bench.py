from __future__ import annotations

from bench.writer import bench_writer


def test_the_yardstick_measures_both_writers():
    rates = bench_writer(small=2000, large=5)
    assert set(rates) == {f"{w}_{k}" for w in ("plain", "bag") for k in ("small_per_s", "large_mb_per_s")}
    assert all(rate > 0 for rate in rates.values())
    # half the plain writer's rate is far from the measured three quarters, and far from a mistake of an order
    assert rates["bag_small_per_s"] > 0.25 * rates["plain_small_per_s"]
