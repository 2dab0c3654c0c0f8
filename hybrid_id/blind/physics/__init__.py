"""Laws of drives and two engines that integrate them; imports nothing of the package."""
