"""What was found, in the formats of others: MuJoCo, domain randomisation, torch programs."""
