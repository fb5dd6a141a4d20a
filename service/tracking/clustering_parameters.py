"""The constants of the clustering: unit, default and source of each."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

from service.errors import InvalidInput

ENGINES = ("numba", "scikit-learn")


@dataclass(frozen=True, slots=True)
class ClusteringParameters:
    """How the points of the last frames become clusters.

    Defaults are those of a study on simulated traffic, azimuth noise to 0.5 deg: four frames miss a quarter
    of what one frame misses at no false clusters, and the lateral split takes back what they merge.
    """

    engine: str = "numba"  # or "scikit-learn", the reference; they differ in border points only
    window_frames: int = (
        4  # frames clustered together; 6 with min_points 6 for higher quality at twice the time
    )
    min_points: float = 4.0  # weight within the radius that makes a point a core point

    # Radius of the neighbourhood in each feature.
    eps_along_offset_m: float = 1.2  # along the road: offset + slope * median speed, within the limits
    eps_along_slope_s: float = 0.12  # gaps grow with speed; a fixed 3 m merges a queue
    eps_along_min_m: float = 1.4
    eps_along_max_m: float = 3.0
    eps_along_growth_per_m: float = 0.002  # relative growth with range; 0.004 merges again
    eps_across_m: float = 1.3  # half a vehicle and some; the azimuth noise comes on top, in quadrature
    eps_across_noise: float = 1.0  # standard deviations of the azimuth noise
    eps_doppler_mps: float = 1.2
    eps_age_s: float = 0.5  # a window of four frames at 20 Hz spans 0.3 of the radius

    compensation_min_cosine: float = (
        0.3  # between line of sight and road; below, Doppler says little of the speed
    )

    # Lateral split of two vehicles side by side.
    split_width_m: float = 1.9  # points of one vehicle spread over it evenly
    split_skip_ratio: float = 1.3  # no test below this multiple of one vehicle's variance plus the margin
    split_skip_margin_m2: float = 0.3
    split_min_points: int = 6
    split_separation_m: float = 2.4  # between the two centres; lanes are 3 m apart and more
    split_gain: float = 14.0  # variance explained by the cut, over one vehicle's
    split_gain_per_point: float = (
        0.64  # a Gaussian cut at its best place explains 2 / pi of its variance by chance
    )
    split_rounds: int = 3  # each can halve every piece: up to 8 abreast

    def __post_init__(self) -> None:
        if self.engine not in ENGINES:
            raise InvalidInput.at("/clustering/engine", f"want {' or '.join(ENGINES)}, got {self.engine!r}")
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if not isinstance(value, str) and not 0 <= value < math.inf:
                raise InvalidInput.at(f"/clustering/{field.name}", f"want a number from 0, got {value}")
        for name in (
            "window_frames", "min_points", "eps_along_min_m", "eps_across_m", "eps_doppler_mps", "eps_age_s",
            "compensation_min_cosine",
        ):  # fmt: skip
            if getattr(self, name) == 0:
                raise InvalidInput.at(f"/clustering/{name}", "want more than 0")
        if self.eps_along_max_m < self.eps_along_min_m:
            raise InvalidInput.at("/clustering/eps_along_max_m", f"want at least {self.eps_along_min_m}")
