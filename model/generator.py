"""A random generator exact in doubles, so that C and Python draw alike, as expressions."""

from __future__ import annotations

import casadi as ca

SX = ca.SX

MULTIPLIER, MODULUS = 16807, 2147483647
SEED_MULTIPLIER, SEED_OFFSET = (
    48271,
    715225741,
)  # scramble the seed, so that neighbouring seeds give unrelated sequences
WARM_UP = 24  # first draws, which are discarded
NORMAL_DRAWS = 12  # uniform draws whose sum is nearly Gaussian


def draw(s: SX) -> SX:
    """s' = 16807 s mod (2^31 - 1), exact in doubles.

    Source: park1988 section 2.
    """
    product = MULTIPLIER * s
    return product - ca.floor(product / MODULUS) * MODULUS


def scrambled(seed: SX) -> SX:
    """Return the start state of the generator, 1 ... MODULUS - 1; near seeds are far apart."""
    mixed = SEED_MULTIPLIER * ca.floor(seed) + SEED_OFFSET
    s = 1 + mixed - ca.floor(mixed / (MODULUS - 1)) * (MODULUS - 1)
    for _ in range(WARM_UP):
        s = draw(s)
    return s


def normal(s: SX) -> tuple[SX, SX]:
    """Return a nearly Gaussian number of variance 1, the sum of 12, and the generator after."""
    total = SX(0)
    for _ in range(NORMAL_DRAWS):
        s = draw(s)
        total += s / MODULUS
    return total - NORMAL_DRAWS / 2, s
