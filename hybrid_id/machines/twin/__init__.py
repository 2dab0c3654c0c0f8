"""Digital twins: machines whose truth is known, for the paper's campaign, the demo, and controllers to drive.

Their dry friction is set-valued and their switches between stick and slip are located inside the step
(`physics.stick_slip`), so that no smoothing of the identification can be mistaken for physics.
"""
