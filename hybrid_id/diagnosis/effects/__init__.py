"""The effects of the catalogue, by place; importing this package registers them."""

from hybrid_id.diagnosis.effects import friction, input, load, motor, transmission

__all__ = ["friction", "input", "load", "motor", "transmission"]
