// A plate with a bent edge crack and a crack inside, made by gmsh's plugin "Crack".
// Make a mesh with:  gmsh -save -format msh41 meshes/crack_plugin.geo   (not with -2: it would mesh again)
// The cracks are lines embedded in one surface. After meshing, the plugin doubles their nodes.

size = 0.008;   // m, away from the cracks
fine = 0.002;   // m, along them

Point(1) = {0.00, 0.00, 0, size};
Point(2) = {0.10, 0.00, 0, size};
Point(3) = {0.10, 0.12, 0, size};
Point(4) = {0.00, 0.12, 0, size};
Point(5) = {0.00, 0.060, 0, fine};  // mouth, on the left edge
Point(6) = {0.02, 0.060, 0, fine};  // where the crack turns
Point(7) = {0.04, 0.050, 0, fine};  // tip
Point(8) = {0.05, 0.090, 0, fine};  // tips of the crack inside
Point(9) = {0.08, 0.100, 0, fine};

Line(1) = {1, 2};
Line(2) = {2, 3};
Line(3) = {3, 4};
Line(4) = {4, 5};  // the edge of the plate is divided at the mouth
Line(5) = {5, 1};
Line(6) = {5, 6};
Line(7) = {6, 7};
Line(8) = {8, 9};
Curve Loop(1) = {1, 2, 3, 4, 5};
Plane Surface(1) = {1};
Line{6, 7, 8} In Surface{1};

Physical Surface("plate", 1) = {1};
Physical Curve("clamp", 2) = {1};
Physical Curve("crack 1", 3) = {6, 7};
Physical Curve("crack 2", 4) = {8};
Physical Point("load", 5) = {3};
Physical Point("mouth", 6) = {5};

Mesh 2;

Plugin(Crack).Dimension = 1;
Plugin(Crack).PhysicalGroup = 3;              // the tag of "crack 1"
Plugin(Crack).OpenBoundaryPhysicalGroup = 6;  // the tag of "mouth": open there
Plugin(Crack).Run;
Plugin(Crack).PhysicalGroup = 4;              // the tag of "crack 2"
Plugin(Crack).OpenBoundaryPhysicalGroup = 0;  // no mouth: closed at both ends
Plugin(Crack).Run;
