"""The error that is meant for the user."""


class InputError(Exception):
    """Something that the user gave is wrong, and this says where and what to do.

    The message is one sentence that names the file, the row (1-based line of the file), the column or
    key, and the remedy. The command line prints it alone, without a traceback, and exits with code 2;
    any other exception is a fault of the program.

    Example:
        >>> raise InputError("my_robot/rec_00.csv, row 17: column u1 is empty; fill it or drop the row")
        Traceback (most recent call last):
        ...
        hybrid_id.errors.InputError: my_robot/rec_00.csv, row 17: column u1 is empty; fill it or drop the row
    """
