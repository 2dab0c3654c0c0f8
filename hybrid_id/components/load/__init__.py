"""Load: masses and torques at the link."""
