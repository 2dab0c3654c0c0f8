"""Input stage: logged channels to the motor's command."""
