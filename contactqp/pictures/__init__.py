"""What a solution looks like: its fields on the bodies and contacts, drawn by matplotlib or written for ParaView.

contact_fields    elastic bodies: displacement, stress, contact force, pressure, gap and status
frame_fields      bars, springs and beams: the same without stress and pressure
drawing           draw(fields, file)
history_drawing   draw_history(history, file): load paths and motions
vtu               write_vtu(fields, file)
"""
