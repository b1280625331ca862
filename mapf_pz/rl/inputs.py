"""The inputs of work that can be continued: what must not have changed in between."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from mapf_pz._internal.digest import NoDigestError, digest
from mapf_pz.instances.instance import InstanceSource


def sources_digest(sources: Iterable[InstanceSource], *others: object) -> str:
    """Return the digest of all maps and scenarios of these sources, and of other inputs.

    Of a source that does not state what it is, the digest is that of a sampled instance.

    Raises `NoDigestError` if one of `others` has none.
    """
    return digest([*map(_source_digest, sources), *others])


def _source_digest(source: InstanceSource) -> str:
    try:
        return digest(source)
    except NoDigestError:
        one = source.sample(np.random.default_rng(0))
        return digest([one.grid.free, one.scenario.starts, one.scenario.goals])
