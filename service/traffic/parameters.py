"""Every constant of traffic analysis, joined into one value, and what it needs of the configuration."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
from dataclasses import dataclass, field

from service.errors import InvalidInput
from service.formats.sensor import TRAFFIC_PREFIX, SensorConfig
from service.tracking.parameters import with_setting
from service.traffic.assignment import AssignmentParameters
from service.traffic.change_evidence import ChangeParameters
from service.traffic.control import given_lanes
from service.traffic.count_parameters import CountParameters
from service.traffic.drift import DriftParameters
from service.traffic.evidence import EvidenceParameters
from service.traffic.identity import IdentityParameters
from service.traffic.learning import LearningParameters
from service.traffic.lines import Line, lines_of
from service.traffic.mapping import Given, MappingParameters
from service.traffic.motion_state import MotionParameters
from service.traffic.paths import PathParameters


@dataclass(frozen=True, slots=True)
class TrafficParameters:
    """How traffic is analysed; `wayside track --set traffic.<group>.<name>=value` changes one value."""

    paths: PathParameters = field(default_factory=PathParameters)
    counting: CountParameters = field(default_factory=CountParameters)
    assignment: AssignmentParameters = field(default_factory=AssignmentParameters)
    changes: ChangeParameters = field(default_factory=ChangeParameters)
    motion: MotionParameters = field(default_factory=MotionParameters)
    evidence: EvidenceParameters = field(default_factory=EvidenceParameters)
    learning: LearningParameters = field(default_factory=LearningParameters)
    identity: IdentityParameters = field(default_factory=IdentityParameters)
    mapping: MappingParameters = field(default_factory=MappingParameters)
    drift: DriftParameters = field(default_factory=DriftParameters)

    def as_dict(self) -> dict[str, object]:
        """Return the parameters as nested plain values."""
        return dataclasses.asdict(self)

    def digest(self) -> str:
        """Return twelve hex digits that name this set of values."""
        text = json.dumps(self.as_dict(), sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()[:12]


@dataclass(frozen=True, slots=True)
class TrafficSetup:
    """The parameters, and the sensor whose traffic it is."""

    parameters: TrafficParameters
    config: SensorConfig
    given: Given  # lanes of that configuration
    lines: tuple[Line, ...]  # its count lines
    digest: str  # of the parameters

    @property
    def travel_heading_rad(self) -> float | None:
        """Return the heading that counts as forward, in the plan frame; None: going away from the radar."""
        heading_deg = self.config.travel_heading_deg
        return None if heading_deg is None else math.radians(heading_deg - self.config.heading_deg)


def traffic_setup(config: SensorConfig) -> TrafficSetup:
    """Return the setup with the configuration's overrides of parameters; raises InvalidInput."""
    parameters = TrafficParameters()
    for key in sorted(config.parameters):
        if key.startswith(TRAFFIC_PREFIX):
            try:
                parameters = with_setting(
                    parameters, key.removeprefix(TRAFFIC_PREFIX), config.parameters[key]
                )
            except InvalidInput as error:
                raise InvalidInput.at(f"/{key}", error.errors[0].reason) from None
    given = given_lanes(config.lanes, parameters.identity)
    return TrafficSetup(parameters, config, given, lines_of(config.count_lines), parameters.digest())
