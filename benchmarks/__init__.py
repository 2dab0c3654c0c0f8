"""Speed comparison with other ways to solve the same problem; see README.md."""
