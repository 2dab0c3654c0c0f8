"""The source paper on digital twins: twins, stages, tables beside the printed ones, controllers, and the page."""
