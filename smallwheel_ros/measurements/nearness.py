# SPDX-License-Identifier: Apache-2.0
"""How near a header is to the words that are known."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from functools import lru_cache

from smallwheel_ros.measurements.units import is_common
from smallwheel_ros.measurements.words import QUALIFIERS, WORDS, plain, splits, tokens_of

_NEAR = 0.6  # share of letters in common: what difflib calls close


@lru_cache(maxsize=1000)
def nearness(text: str) -> Mapping[str, tuple[float, str]]:
    """How near a header is to a word of each quantity, 0.6 to 1, and to which: `hundim. (mm)`, `belasting`.

    The whole of it or a part, spelled alike or cut short. What words of several quantities have says
    nothing: force, de.
    """
    rest = next((rest for rest, tail in splits(text) if is_common(tail)), text.partition("[")[0])
    parts = [plain(token) for token in tokens_of(rest)]
    parts = [part for part in parts if part and part not in _shared_parts()]
    found: dict[str, tuple[float, str]] = {}
    for part in dict.fromkeys(["".join(parts), *parts] if parts else []):
        matcher = difflib.SequenceMatcher(b=part)
        # of so few it may be chance; what are no letters is a syllable or a word each
        fewest = 4 if max(part) < "\u3000" else 2
        for word, name in _telling_words().items():
            matcher.set_seq1(word)
            near = _share_in_common(matcher, fewest)
            near = max(near, _NEAR if len(part) >= 3 and word.startswith(part) else 0.0)
            if near >= _NEAR and near > found.get(name, (0.0, ""))[0]:
                found[name] = near, word
    return found


def _share_in_common(matcher: difflib.SequenceMatcher[str], fewest: int) -> float:
    """Share of letters that two words have in common, 0 if too few."""
    if matcher.real_quick_ratio() < _NEAR or matcher.quick_ratio() < _NEAR:
        return 0.0
    common = sum(block.size for block in matcher.get_matching_blocks())
    return matcher.ratio() if common >= fewest else 0.0


@lru_cache(maxsize=1)
def _shared_parts() -> frozenset[str]:
    """Parts that words of several quantities have, and what stands beside a quantity."""
    owners: dict[str, set[str]] = {}
    for name, line in WORDS.items():
        for part in tokens_of(line.partition("|")[0]):
            owners.setdefault(plain(part), set()).add(name)
    return frozenset(part for part, names in owners.items() if len(names) > 1) | QUALIFIERS


@lru_cache(maxsize=1)
def _telling_words() -> dict[str, str]:
    """The quantity of each word, without its shared parts."""
    found: dict[str, str] = {}
    for name, line in WORDS.items():
        for word in (*line.partition("|")[0].split(","), name):
            parts = [plain(token) for token in tokens_of(word)]
            found["".join(part for part in parts if part not in _shared_parts())] = name
    return {word: name for word, name in found.items() if word}
