// A twisted, tapered compressor blade with a crack at its leading edge, in three dimensions.
// Make a mesh with:  gmsh -3 -format msh41 meshes/solid_blade.geo
// A finer one:       gmsh -3 -format msh41 -setnumber size 0.002 -setnumber fine 0.0007 meshes/solid_blade.geo
// The blade stands along y on the clamp at y = 0; x is the engine's axis. Sections at constant y are
// bent and thickest in the middle of the chord, which stands at an angle to x, the stagger; their
// centroids stand over one another, so that rotation bends the blade little.
// The surface "crack" lies inside: its nodes exist once, and fenics-crack splits it.

SetFactory("OpenCASCADE");
DefineConstant[
  height = 0.123,      // m
  root = 0.048,        // m, chord at the clamp
  tip = 0.040,         // m, chord at the tip
  thick = 0.0056,      // m, largest thickness at the clamp
  thin = 0.0024,       // m, at the tip
  blunt = 0.4,         // thickness of the edges over the largest one
  camber = 0.06,       // height of the middle line over the chord
  stagger = 20,        // degrees, between chord and axis at the clamp
  twist = 30,          // degrees, by which the tip stands steeper
  level = 0.02,        // m, height of the crack
  crack = 0.009,       // m, its radius around the leading edge
  size = 0.007,        // m, of the cells away from the crack
  fine = 0.0022        // m, of those along the crack
];

n = 4;  // pieces of the height
m = 6;  // and of the chord

For i In {0 : n}
  s = i / n;
  c = root + (tip - root) * s;
  t = thick + (thin - thick) * s;
  turn = (stagger + twist * s) * Pi / 180;
  below[] = {};
  above[] = {};
  For k In {0 : m}
    u = -1 + 2 * k / m;
    middle = camber * c * (0.267 - u^2);  // its mean, weighted with the thickness, is zero
    half = t / 2 * (blunt + (1 - blunt) * (1 - u^2));
    a = u * c / 2;
    p = newp;
    Point(p) = {a * Cos(turn) - (middle - half) * Sin(turn), height * s, a * Sin(turn) + (middle - half) * Cos(turn)};
    below[] += {p};
    p = newp;
    Point(p) = {a * Cos(turn) - (middle + half) * Sin(turn), height * s, a * Sin(turn) + (middle + half) * Cos(turn)};
    above[] += {p};
  EndFor
  q = 10 * i;
  Spline(q + 1) = {below[]};
  Line(q + 2) = {below[m], above[m]};
  Spline(q + 3) = {above[]};
  Line(q + 4) = {above[0], below[0]};
  Wire(i + 1) = {q + 1, q + 2, -(q + 3), q + 4};
EndFor
ThruSections(1) = {1 : n + 1};
corner = p;  // of the tip, at its trailing edge

// The crack: what is inside the blade of a circle around the leading edge.
turn = (stagger + twist * level / height) * Pi / 180;
c = root + (tip - root) * level / height;
x0 = -c / 2 * Cos(turn) + 0.733 * camber * c * Sin(turn);
z0 = -c / 2 * Sin(turn) - 0.733 * camber * c * Cos(turn);
Disk(100) = {x0, z0, 0, crack};
Rotate{{1, 0, 0}, {0, 0, 0}, Pi / 2} { Surface{100}; }
Translate{0, level, 0} { Surface{100}; }
BooleanIntersection{ Surface{100}; Delete; }{ Volume{1}; }
BooleanFragments{ Volume{1}; Delete; }{ Surface{100}; Delete; }

// 101 is the concave side, as gmsh numbers what it has cut (look at the names in a picture).
Physical Volume("blade", 1) = {1};
Physical Surface("clamp", 2) = {102};
Physical Surface("crack", 3) = {100};
Physical Surface("pressure_side", 4) = {101};
Physical Surface("suction_side", 5) = {107};
Physical Point("load", 6) = {corner};

// Cells grow with the distance from the crack.
Field[1] = MathEval;
Field[1].F = Sprintf("min(%g, %g + 0.4 * sqrt(max(sqrt((x - (%g))^2 + (z - (%g))^2) - %g, 0)^2 + (y - %g)^2))",
                     size, fine, x0, z0, crack, level);
Background Field = 1;
Mesh.MeshSizeExtendFromBoundary = 0;
Mesh.MeshSizeFromPoints = 0;
Mesh.ElementOrder = 2;
Mesh.HighOrderOptimize = 1;
