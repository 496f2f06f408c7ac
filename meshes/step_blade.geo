// A twisted blade with a fillet above its root, without a crack: the part of demos/step_blade.py and docs/cad.md, in mm.
//     gmsh -0 meshes/step_blade.geo -o blade.step
// -setnumber changes a parameter, e.g. -setnumber TWIST 40.
SetFactory("OpenCASCADE");
DefineConstant[ HEIGHT = 80, CHORD = 30, THICK = 4, CAMBER = 2.5, TWIST = 25, FILLET = 2, ROOT = 10 ];

// Four sections, of a concave and a convex spline between blunt edges.
For k In {0:3}
  y = -1 + k * (HEIGHT + 1) / 3;
  turn = (Pi / 180) * TWIST * k / 3;
  p = newp;
  For side In {0:1}
    For j In {0:6}
      s = j / 6;
      u = CHORD * (s - 0.5);
      v = 4 * CAMBER * s * (1 - s) + (1 - 2 * side) * (0.35 + 2 * (THICK - 0.7) * s * (1 - s));
      Point(p + 7 * side + j) = { u * Cos(turn) - v * Sin(turn), y, u * Sin(turn) + v * Cos(turn) };
    EndFor
  EndFor
  c = newc;
  Spline(c) = { p:p+6 };
  Spline(c + 1) = { p+7:p+13 };
  Line(c + 2) = { p+6, p+13 };
  Line(c + 3) = { p+7, p };
  Curve Loop(1000 + k) = { c, c + 2, -(c + 1), c + 3 };
EndFor
ThruSections(1) = { 1000:1003 };
Box(2) = { -0.7 * CHORD, -ROOT, -8, 1.4 * CHORD, ROOT, 20 };
solid() = BooleanUnion{ Volume{1}; Delete; }{ Volume{2}; Delete; };
joint() = Curve In BoundingBox{ -0.6 * CHORD, -0.01, -7, 0.6 * CHORD, 0.01, 11 };
If (FILLET > 0)
  Fillet{ solid(0) }{ joint() }{ FILLET }
EndIf
