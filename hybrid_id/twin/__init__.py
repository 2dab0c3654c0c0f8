"""Digital twins: machines whose truth is known, simulated by an integrator that shares no code with the models.

Dry friction is set-valued here and motion is a hybrid automaton (stick, slip forwards, slip backwards) whose
switching instants are located inside the step, so that no smoothing of the identification can be mistaken
for physics. Nothing is imported from the package but records and errors.
"""
