"""The motion to the cut and back: `decision` decides, by two straight lines and two joint lines.

`model` is what is asked and answered, `report` what becomes of the answer; `straight_line` finds entry and exit pose
and has their lines verified as the cut is; `joint_line` bounds the margins of the wrist centre by `curve`, and says in
`sentences` what is lacking; `standing` says which joint to move where no approach may begin.
"""
