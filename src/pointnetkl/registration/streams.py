"""Streams of random numbers of one submap: no two purposes share a draw, even where the seeds of stages agree.

A generator's key is (seed, survey, submap, stream). 0 is no stream: NumPy's seeding ignores it at the end of a key.
Monte Carlo as a method (`mc_<runs>`) has its number of runs as stream, which is far above these.
"""

from enum import IntEnum


class Stream(IntEnum):
    """What the random numbers are for."""

    LABEL = 1
    HELD_OUT = 2  # errors that no label was made of
    CLOSURE = 3  # registrations of loop closures with all submaps at their true poses


SELF_REGISTRATION = (0, 1)  # the end of a longer key, so that no number of runs equals it
