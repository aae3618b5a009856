"""A check that a bonus really works: inside an agent, and on an environment."""

from deep_curiosity.integrations.check.experiments import check_integration
from deep_curiosity.integrations.check.findings import Finding, Report

__all__ = ["Finding", "Report", "check_integration"]
