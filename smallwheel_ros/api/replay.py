# SPDX-License-Identifier: Apache-2.0
"""`replay`: a recorded drive through the estimator that the node runs."""

from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from smallwheel_ros.arguments import (
    Bag,
    Config,
    Copied,
    Flag,
    Folder,
    Hertz,
    Remaps,
    SoilFile,
    unheard,
)

if TYPE_CHECKING:
    from smallwheel_ros.replay.result import Replayed


def replay(
    bag: Bag,
    config: Config | None = None,
    output: Folder | None = None,
    *,
    remaps: Remaps | None = None,
    clock: Flag = True,
    copy: Copied = "all",
    rate: Hertz | None = None,
    soil_file: SoilFile | None = None,
    progress: Callable[[int, int], object] = unheard,
) -> "Replayed":
    """Run the node's estimator over a recorded drive.

    Saved as .html, the result is a report.

    Parameters
    ----------
    bag : path
        A rosbag2 folder, a .mcap or .db3 file, or a ROS 1 .bag.
    config : path, optional
        The node's parameter file; if not given, what `smallwheel init` finds in the bag.
    output : path, optional
        Folder for tables, a bag and a cost map. The command needs it, except with --topics; a call from
        Python without it has a temporary one, which is deleted with the result.
    remaps : dict, as ``{"odom": "/rover/odom"}``, optional
        The node's name of an input, and the topic of the bag that it is read from.
    clock : bool, optional
        Compare stamps with the times of recording, as the node does with use_sim_time; otherwise only with
        each other.
    copy : {'all', 'used', 'none'}, optional
        Topics that are copied into the new bag, beside the estimates.
    rate : float, optional
        Largest rate of estimates of each wheel (Hz), in place of the parameter mobility.rate; 0: one for
        each measured sinkage.
    soil_file : path, optional
        Start from the soil saved there, if any, and save it there at the end.
    progress : callable, optional
        Called with the number of messages done and their total.

    Returns
    -------
    Replayed
        The estimates, what was noticed about the sensors, and the files written.

    Examples
    --------
    >>> import smallwheel_ros as sw
    >>> drive = sw.replay("drive", config="rover.yaml", output="out")
    >>> drive.state
    'complete'
    """
    from smallwheel_ros.replay.replay import replay as replay_bag
    from smallwheel_ros.replay.spec import ReplaySpec, read_remaps, with_assumed_config

    place = TemporaryDirectory(prefix="smallwheel-") if output is None else None
    spec = ReplaySpec(
        Path(bag),
        Path(config or ""),
        Path(place.name if place is not None else output),  # type: ignore[arg-type]  # one of both
        read_remaps(f"{name}:={topic}" for name, topic in (remaps or {}).items()),
        clock,
        copy,
        rate,
        soil_file=None if soil_file is None else Path(soil_file),
    )
    if config is None:
        spec = with_assumed_config(spec)
    result = replay_bag(spec, progress=progress)
    result.place = place
    return result
