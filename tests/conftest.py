"""What holds for every test."""

from hypothesis import HealthCheck, settings

# The time an example takes says only how busy the machine is.
settings.register_profile(
    "any machine", settings.default, deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("any machine")
