"""Speed against accuracy: what an approximation saves, in memory reads before all."""
