"""Methods that the blind check measures: the diagnosis, and the simple ones that it has to beat.

Each sees the records and the nominal model of one case and nothing else, and answers as ``diagnosis.json`` does.
None of them may know the generator.
"""
