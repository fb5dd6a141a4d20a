"""What is wrong with a sensor's stream, in words."""

from __future__ import annotations

from typing import Annotated, Literal

from fastapi import APIRouter, Query
from pydantic import BaseModel, Field

from service.api.dependencies import PREFIX, ReadKey, SensorPath, ServicesDep
from service.pipeline.diagnosing import diagnose_sensor

router = APIRouter(prefix=PREFIX, tags=["sensors"])


class FindingReply(BaseModel):
    """One thing that is wrong with a sensor's stream."""

    code: str = Field(description="stable name of the fault, such as doppler_sign")
    severity: Literal["fault", "hint"]
    sentence: str
    evidence: dict[str, float] = Field(description="the numbers behind it, with units in their names")
    advice: str


class DiagnosisReply(BaseModel):
    """What was found in a sensor's newest frames and tracks."""

    sensor_id: str
    findings: list[FindingReply]
    measured: dict[str, float]
    not_told: list[str] = Field(description="what could not be judged, and why")


@router.get("/sensors/{sensor_id}/diagnosis")
def read_diagnosis(
    sensor_id: SensorPath,
    services: ServicesDep,
    _: ReadKey,
    seconds: Annotated[float, Query(ge=5, le=120, description="of frames that are looked at")] = 60,
    minutes: Annotated[float, Query(ge=1, le=60, description="of tracks that tell the mounting")] = 5,
) -> DiagnosisReply:
    """Say what is wrong with the sensor's stream; docs/doctor.md explains each finding."""
    found = diagnose_sensor(services.host, services.engine, sensor_id, seconds=seconds, minutes=minutes)
    return DiagnosisReply(
        sensor_id=sensor_id,
        findings=[
            FindingReply(
                code=f.code, severity=f.severity, sentence=f.sentence, evidence=f.evidence, advice=f.advice
            )
            for f in found.findings
        ],
        measured=found.measured,
        not_told=list(found.not_told),
    )
