// A tapered, curved blade with a crack at its leading edge, made by gmsh's plugin "Crack".
// Make a mesh with:  gmsh -save -format msh41 meshes/blade.geo   (not with -2: it would mesh again)
// Another blade:     gmsh -save -format msh41 -setnumber crack 0.012 -setnumber bow 0 meshes/blade.geo
// The middle of the chord is at x = root / 2 + bow (y / height)^2; the chord shrinks linearly.

DefineConstant[
  height = 0.2,    // m
  root = 0.04,     // m, chord at the clamp
  tip = 0.026,     // m, chord at the tip
  bow = 0.004,     // m, by which the tip leans to the trailing edge, x > 0
  level = 0.03,    // m, height of the crack
  crack = 0.009,   // m, its length
  size = 0.008,    // m, of the cells away from the crack
  fine = 0.0018    // m, along it
];

n = 8;  // pieces of the trailing edge, and of each part of the leading one

trailing[] = {};
For i In {0 : n}
  y = height * i / n;
  p = newp;
  Point(p) = {root / 2 + bow * (y / height)^2 + (root + (tip - root) * y / height) / 2, y, 0, size};
  trailing[] += {p};
EndFor

upper[] = {};  // from the tip down to the crack's mouth
For i In {0 : n}
  y = height + (level - height) * i / n;
  p = newp;
  Point(p) = {root / 2 + bow * (y / height)^2 - (root + (tip - root) * y / height) / 2, y, 0, size};
  upper[] += {p};
EndFor
mouth = upper[n];

lower[] = {mouth};  // from the mouth down to the clamp
For i In {1 : n}
  y = level * (1 - i / n);
  p = newp;
  Point(p) = {root / 2 + bow * (y / height)^2 - (root + (tip - root) * y / height) / 2, y, 0, size};
  lower[] += {p};
EndFor
Characteristic Length {mouth} = fine;

end = newp;
Point(end) = {root / 2 + bow * (level / height)^2 - (root + (tip - root) * level / height) / 2 + crack, level, 0, fine};

Line(1) = {lower[n], trailing[0]};
Spline(2) = {trailing[]};
Line(3) = {trailing[n], upper[0]};
Spline(4) = {upper[]};
Spline(5) = {lower[]};
Line(6) = {mouth, end};
Curve Loop(1) = {1, 2, 3, 4, 5};
Plane Surface(1) = {1};
Line{6} In Surface{1};

Physical Surface("blade", 1) = {1};
Physical Curve("clamp", 2) = {1};
Physical Curve("crack", 3) = {6};
Physical Point("load", 4) = {trailing[n]};
Physical Point("mouth", 5) = {mouth};

Mesh 2;

Plugin(Crack).Dimension = 1;
Plugin(Crack).PhysicalGroup = 3;
Plugin(Crack).OpenBoundaryPhysicalGroup = 5;
Plugin(Crack).Run;
