"""Everything that makes a picture.

- `splat`: points with a depth buffer, what most pictures are drawn with.
- `grasp_picture`, `noise_picture`: clouds with grasps, what a depth camera does to a scene.
- `object_picture`: objects with their convex pieces.
- `gripper_picture`: postures of one gripper; `frame_picture`, with `frame_raster` and
  `closing_motion`: its frames and what closing sweeps; `frame_page`: their table.
- `data_charts`, `library_pictures`, `training_curves`, `reliability_picture`: data sets,
  libraries, training, scores.
- `contact_sheet`: many pictures in one.
"""
