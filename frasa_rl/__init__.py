"""From a calibrated MuJoCo model to a stand-up policy.

calibrated.xml + randomization.yaml -> StandUp -> Policy
"""

__version__ = "0.1.0"
