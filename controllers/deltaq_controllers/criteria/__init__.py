"""Performance criteria of redundant robots: one table, for many configurations at once, with gradients."""

from deltaq_controllers.criteria.formulas import Postures, RobotData
from deltaq_controllers.criteria.table import BY_NAME, TABLE, Category, Criterion, Normalised

__all__ = ["BY_NAME", "TABLE", "Category", "Criterion", "Normalised", "Postures", "RobotData"]
