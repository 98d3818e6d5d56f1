"""Random generators keyed by what they are for, never by what was drawn before."""

from hashlib import blake2b

import numpy as np


def generator(seed: int, *scope: str | int) -> np.random.Generator:
    """Return the Philox generator of a seed and a scope: what is drawn, of which sensor, at which stamp. Equal
    arguments give equal numbers in any process, thread and order; others are independent.
    """
    digest = blake2b(digest_size=16)
    for part in (seed, *scope):
        text = f"{type(part).__name__}:{part}".encode()
        digest.update(len(text).to_bytes(8, "little") + text)
    return np.random.Generator(np.random.Philox(key=int.from_bytes(digest.digest(), "little")))
