# SPDX-License-Identifier: Apache-2.0
"""What to replay and how; plain values, so that it can be sent to another process or machine."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from smallwheel_ros.bags.files import storage_kind
from smallwheel_ros.common.errors import SmallwheelError
from smallwheel_ros.common.version import __version__

Copy = Literal["all", "used", "none"]
COPIES: tuple[Copy, ...] = ("all", "used", "none")
_HASHED = 1 << 20


class ReplayError(SmallwheelError):
    """A bag that nothing can be estimated from, options that do not go together, or no place."""


@dataclass(frozen=True)
class ReplaySpec:
    """One replay.

    Attributes
    ----------
    bag, config, folder
        The bag, the node's parameter file, and where everything goes.
    remaps
        Full names: the node's, then the bag's.
    clock
        Judge stamps by the times of recording (or the bag's /clock), as the node does with
        use_sim_time; otherwise they are only compared with each other.
    copy
        Which of the bag's topics go into the new bag beside the estimates.
    rate
        Hz, in place of the parameter mobility.rate; None: as that is.
    notes
        What is to be said of it beforehand.
    """

    bag: Path
    config: Path
    folder: Path
    remaps: Mapping[str, str] = field(default_factory=dict)
    clock: bool = True
    copy: Copy = "all"
    rate: float | None = None
    notes: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """The bag's name without folder and suffixes."""
        name = self.bag.resolve().name
        if self.bag.is_dir():
            return name
        kind = storage_kind(self.bag) or ""
        return name.removesuffix(".zstd").removesuffix(kind)

    def fingerprint(self) -> str:
        """Return what tells this replay from any other: the bag, the parameters, the options.

        Of the bag the names, sizes, times and first megabyte of its files count.
        """
        digest = hashlib.sha256(__version__.encode())
        bag = [self.bag]
        if self.bag.is_dir():
            bag = sorted(file for file in self.bag.iterdir() if file.is_file())
        for file in bag:
            state = file.stat()
            digest.update(f"{file.name} {state.st_size} {state.st_mtime_ns}".encode())
            with file.open("rb") as stream:
                digest.update(stream.read(_HASHED))
        digest.update(self.config.read_bytes())
        options: Any = (sorted(self.remaps.items()), self.clock, self.copy, self.rate)
        digest.update(repr(options).encode())
        return digest.hexdigest()
