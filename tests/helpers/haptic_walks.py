"""Places that wander as a hand does."""

from random import Random


def walk(seed, cycles=3000):
    """Yield a place (m) and its velocity (m/s), of one axis."""
    random, place, speed = Random(seed), 0.0, 0.0
    for _ in range(cycles):
        speed += random.uniform(-0.01, 0.01) - 0.002 * speed - 0.02 * place
        place += speed / 1000
        yield place, speed


def walks():
    """Four of them at once: of a hand and of a tip along x and y."""
    return zip(*(walk(seed) for seed in range(4)), strict=True)
