"""The paper's campaign, section by section, on digital twins: its stages, its tables, its controllers."""
