"""A robot cell that picks.

- `robot_cell`: bin, objects, camera and rack of grippers in MuJoCo; `rest`: how objects come to
  rest; `inputs`: what a cell is told, checked.
- `pick_cycle`: look, try, leave the scene as the attempt leaves it; `failure_memory`: where it is
  not tried again.
- `clearing`: the rules by which a bin is emptied; `demo`: a synthesizer that empties one;
  `pick_sheet`: the picture of a run.
"""
