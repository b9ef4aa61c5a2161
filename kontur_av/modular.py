"""Numbers that begin anew after a power of two: sequence numbers, timestamps, offsets."""


def serial_difference(difference: int, bits: int = 32) -> int:
    """Return the difference of two numbers of so many bits that is nearest to 0."""
    half = 1 << bits - 1
    return (difference + half & 2 * half - 1) - half
