"""Every constant of the tracking core: its unit, its default and where it comes from.

`SensorModel` is what an installer knows of the radar; `TrackerParameters` is how the tracker works. Both are
frozen values: a change is a new value (`with_setting`), and `digest` names one set of values for good.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import types
import typing
from dataclasses import dataclass, field
from typing import TypeVar

from service.errors import InvalidInput
from service.tracking.association_methods import check_method
from service.tracking.births import BirthParameters
from service.tracking.clustering_parameters import ClusteringParameters
from service.tracking.clutter import ClutterParameters
from service.tracking.creeping import CreepingParameters
from service.tracking.existence import ExistenceParameters
from service.tracking.extent import ExtentParameters
from service.tracking.filters.parameters import FilterParameters
from service.tracking.merging import MergingParameters
from service.tracking.moved_boxes import RearrangingParameters
from service.tracking.posts import PostParameters
from service.tracking.queue_lanes import QueueLaneParameters
from service.tracking.recovery import RecoveryParameters
from service.tracking.resting import RestingParameters
from service.tracking.road_map import RoadMapParameters
from service.tracking.shading import ShadingParameters
from service.tracking.splitting import SplittingParameters
from service.tracking.stood import StoodParameters
from service.tracking.tandem import TandemParameters

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class SensorModel:
    """The radar as mounted: geometry, noise, resolution and the region in which it sees."""

    rate_hz: float = 20.0
    mount_height_m: float = 6.0
    scatter_height_m: float = 0.6  # height above the road of most echoes
    azimuth_offset_rad: float = 0.0  # added to each measured azimuth
    range_min_m: float = 20.0
    range_max_m: float = 150.0
    azimuth_max_rad: float = math.radians(45.0)
    range_resolution_m: float = 0.75
    velocity_resolution_mps: float = 0.25
    azimuth_resolution_rad: float = math.radians(1.5)
    range_std_m: float = 0.15  # standard deviations at `noise_snr_db`
    velocity_std_mps: float = 0.10
    azimuth_std_rad: float = math.radians(0.3)
    azimuth_floor_rad: float = math.radians(0.1)  # the azimuth never gets better than this
    noise_snr_db: float = 20.0
    detection_threshold_db: float = 12.0


@dataclass(frozen=True, slots=True)
class AssociationParameters:
    """Gates and densities of the association of points with boxes."""

    gate: float = 12.0  # squared distance of a point to a box
    cluster_gate: float = 25.0  # ... when its cluster belongs to that box alone
    ellipse_gate: float = 25.0  # squared distance of a measured centre of another box's points; 3 dimensions
    outlier_d2: float = 16.0  # largest squared distance at which a box's own points are believed as they are
    tentative_handicap: float = 4.0  # in squared distance: a confirmed box goes first
    growth_reach_m: float = (
        5.0  # a box may reach this far beyond its far end, half a second of travel at most
    )
    young_hits: int = 40  # hits up to which the near end may reach out half as far, later a fifth
    clutter_per_m2_mps: float = (
        1e-5  # density of measurements that are of no track, in the plane and in Doppler
    )
    clutter_per_m2: float = 3e-4  # the same for a radar without Doppler
    association: str = "jpda"  # or "maximum-probability"
    temper: float = 1.0  # power of the joint weights of contested components; 1: none
    doppler_noise_factor: float = 1.3  # wheels and turning bodies spread the Doppler of a vehicle's points
    doppler_floor_mps: float = 0.05
    doppler_margin_mps: float = (
        0.2  # that a point's range rate may differ from its box's without a cost of note
    )
    widen_after: int = 3  # empty frames in a row after which the gate is widened
    widen_position_m2: float = 0.03  # added per frame to each position variance
    widen_velocity_m2ps2: float = 0.5  # ... and to each of velocity, of what is missed in plain sight ...
    widen_shadowed_m2ps2: float = 0.1  # ... and of what a nearer vehicle may hide
    hidden_travel_m: float = 15.0  # a box in a shadow that has not come so far may stand on posts
    off_road_range_m: float = 140.0  # farther out the road map has not been taught
    birth_accel_std_mps2: float = 2.0

    def __post_init__(self) -> None:
        """Raise InvalidInput when there is no such association."""
        check_method(self.association)


@dataclass(frozen=True, slots=True)
class TrackerParameters:
    """How the tracker works; one set of defaults serves every road."""

    sensor: SensorModel = field(default_factory=SensorModel)
    profile: str = (
        "default"  # whose values these are, before settings of one's own; service.tracking.profiles
    )
    filter: str = "astekf"  # name in service.tracking.filters.registry
    filters: FilterParameters = field(default_factory=FilterParameters)
    # three points, not four: a car at 140 m gives one a frame, and two frames of three start its track
    clustering: ClusteringParameters = field(default_factory=lambda: ClusteringParameters(min_points=3.0))
    clutter: ClutterParameters = field(default_factory=ClutterParameters)
    boxes: AssociationParameters = field(default_factory=AssociationParameters)
    extent: ExtentParameters = field(default_factory=ExtentParameters)
    existence: ExistenceParameters = field(default_factory=ExistenceParameters)
    shading: ShadingParameters = field(default_factory=ShadingParameters)
    queue_lanes: QueueLaneParameters = field(default_factory=QueueLaneParameters)
    stood: StoodParameters = field(default_factory=StoodParameters)
    creeping: CreepingParameters = field(default_factory=CreepingParameters)
    posts: PostParameters = field(default_factory=PostParameters)
    birth: BirthParameters = field(default_factory=BirthParameters)
    merging: MergingParameters = field(default_factory=MergingParameters)
    tandem: TandemParameters = field(default_factory=TandemParameters)
    splitting: SplittingParameters = field(default_factory=SplittingParameters)
    rearranging: RearrangingParameters = field(default_factory=RearrangingParameters)
    resting: RestingParameters = field(default_factory=RestingParameters)
    road: RoadMapParameters = field(default_factory=RoadMapParameters)
    # at 20 Hz a lost track lives for a quarter of a second: three scans, anywhere within near_m
    recovery: RecoveryParameters = field(
        default_factory=lambda: RecoveryParameters(
            after=3, horizon=3, near_d2=400.0, near_m=4.0, speed_min_mps=2.0
        )
    )

    def with_setting(self, key: str, text: str) -> TrackerParameters:
        """Return a copy with one dotted key set from its text, such as ("clustering.window_frames", "6").

        Raises InvalidInput naming the key when it does not exist or the text does not fit its type.
        """
        if key == "profile":
            raise InvalidInput.at("/profile", "is chosen before all settings, not by one")
        return with_setting(self, key, text)

    def as_dict(self) -> dict[str, object]:
        """Return the parameters as nested plain values."""
        return dataclasses.asdict(self)

    def digest(self) -> str:
        """Return twelve hex digits that name this set of values."""
        text = json.dumps(self.as_dict(), sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()[:12]


def with_setting(group: T, key: str, text: str) -> T:
    """Return a copy of a frozen dataclass with one dotted key set from its text; raises InvalidInput."""
    return typing.cast("T", _set(group, key, key.split("."), text))


def _set(group: object, key: str, path: list[str], text: str) -> object:
    names = {f.name for f in dataclasses.fields(group)}  # type: ignore[arg-type]
    head, rest = path[0], path[1:]
    if head not in names:
        raise InvalidInput.at(
            f"/{key}", f"no such parameter; {head!r} is not one of {', '.join(sorted(names))}"
        )
    value = getattr(group, head)
    if dataclasses.is_dataclass(value):
        if not rest:
            raise InvalidInput.at(f"/{key}", "names a group of parameters, not one of them")
        return dataclasses.replace(group, **{head: _set(value, key, rest, text)})  # type: ignore[type-var]
    if rest:
        raise InvalidInput.at(f"/{key}", f"{head!r} is a value, not a group")
    kind = typing.get_type_hints(type(group))[head]
    return dataclasses.replace(group, **{head: _parse(kind, key, text)})  # type: ignore[type-var]


def _parse(kind: object, key: str, text: str) -> object:
    optional = isinstance(kind, types.UnionType)
    kinds = typing.get_args(kind) if optional else (kind,)
    if type(None) in kinds and text.lower() in {"none", "null"}:
        return None
    target = next(k for k in kinds if k is not type(None))
    if target is bool:
        if text.lower() not in {"true", "false"}:
            raise InvalidInput.at(f"/{key}", f"want true or false, got {text!r}")
        return text.lower() == "true"
    try:
        value = target(text)
    except ValueError:
        raise InvalidInput.at(f"/{key}", f"want {target.__name__}, got {text!r}") from None
    if isinstance(value, float) and not math.isfinite(value):
        raise InvalidInput.at(f"/{key}", f"want a finite number, got {text!r}")
    return value
