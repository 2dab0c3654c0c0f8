"""`python -m hybrid_id` is the console script `hybrid-id`."""

from hybrid_id.cli import main

if __name__ == "__main__":
    main()
