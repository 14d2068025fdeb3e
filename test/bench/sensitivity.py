"""What ``learned`` leaves with each threshold of the learner halved and doubled: ``python -m bench.sensitivity``.

The paper's pass with the inertia of the moving arm; largest deviation [um] of the plant's true tool after four passes.
Prints a Markdown table. Run it in ``test/``; it takes some ten minutes.
"""

from unittest import mock

from bench.learning_targets import Row
from kr270_milling.cell.jobs import compensated, compensator, simulate
from kr270_milling.cell.models import path_of
from kr270_milling.physics.compensation import learning

MODEL = ("dynamics.damping_ratio=0.08", "dynamics.follow_pose=true", "stock.grid_step_um=20")
ROWS = (
    Row("compliance × 1.2", MODEL, compliance=1.2),
    Row("frequency × 0.9, damping / 2", MODEL, frequency=0.9, damping=0.5),
    Row("the same, noise 20 µm", MODEL, frequency=0.9, damping=0.5, noise=20e-6),
)
NUMBERS = ("UNSCORED", "FREE", "ALONG", "SMOOTHNESS", "ROUGH", "MISFIT")
FACTORS = (0.5, 2.0)


def scaled(name: str, key: str | None, factor: float):
    """A threshold, or an entry of PRIOR, times a factor."""
    before = getattr(learning, name)
    return mock.patch.object(learning, name, before * factor if key is None else {**before, key: before[key] * factor})


def main() -> None:
    plants = [(row.cell, row.plant(row.cell)) for row in ROWS]
    plants = [(c.replace(compensation=c.compensation.replace(max_passes=row.passes)), p)
              for row, (c, p) in zip(ROWS, plants, strict=True)]  # fmt: skip
    originals = [simulate(cell, plant=plant) for cell, plant in plants]

    def left() -> list[float]:
        results = []
        for (cell, plant), original in zip(plants, originals, strict=True):
            by = compensator(cell, path_of(cell).target, "learned")
            plant.passes = 1  # the noise of each row is that of the first learning
            ran = compensated(cell, original, "learned", by=by, plant=plant)
            results.append(1e6 * ran.scores.max_deviation)
        return results

    print("| threshold | value | " + " | ".join(f"{row.name}: ½, 2" for row in ROWS) + " |")
    print("| --- | --- |" + " --- |" * len(ROWS))
    none = [1e6 * original.scores.max_deviation for original in originals]
    print("| without correction | | " + " | ".join(f"{v:.1f}" for v in none) + " |")
    print("| as shipped | | " + " | ".join(f"{v:.2f}" for v in left()) + " |", flush=True)
    cases = [("PRIOR", key, value) for key, value in learning.PRIOR.items()]
    cases += [(name, None, getattr(learning, name)) for name in NUMBERS]
    for name, key, value in cases:
        columns = []
        for factor in FACTORS:
            with scaled(name, key, factor):
                columns.append(left())
        texts = [f"{half:.2f}, {double:.2f}" for half, double in zip(*columns, strict=True)]
        print(f"| `{name}{'' if key is None else f' {key}'}` | {value:g} | " + " | ".join(texts) + " |", flush=True)


if __name__ == "__main__":
    main()
