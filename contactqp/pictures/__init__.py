"""Pictures of solutions: their fields on bodies and contacts, drawn by matplotlib or written for ParaView.

contact_fields    elastic bodies: displacement, stress, contact force, pressure, gap and status; at large deformation
drawing           draw(fields, file): elastic bodies, those in space by space_drawing, which has membranes too
frame_drawing     structure_figure(fields): bars, springs, beams, strings and matrices;
                  solution_figure(solution): forces and gaps as bars, of problems without geometry
history_drawing   draw_history(history, file): load paths, motions, load cases; curves of history_panels
vtu               write_vtu(fields, file)
style             colours, markers, units, magnification
"""
