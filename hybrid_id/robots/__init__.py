"""Any arm: its rigid-body tree, and the reader of its MJCF or URDF."""
