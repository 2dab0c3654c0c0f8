"""Laws of drives, the machines that they make up, and what steps these through time; imports nothing of the package."""
