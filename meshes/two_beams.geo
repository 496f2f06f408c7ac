// Two beams, one above the other, that meet over the last quarter of their length.
// Make a mesh with:  gmsh -3 -format msh41 meshes/two_beams.geo
// Towards the clamps at x = 0 a wedge of air is between them. Where they meet their nodes exist once:
// fenics-crack splits them at the surface "crack", which ends nowhere inside, so that two bodies are left.

DefineConstant[
  length = 0.16,   // m
  thick = 0.0034,  // m, of each where they meet
  air = 0.0002,    // m, by which each is thinner at the clamp
  width = 0.01,    // m
  size = 0.005     // m, of the cells
];

Point(1) = {0, 0, 0, size};
Point(2) = {0.75 * length, 0, 0, size};
Point(3) = {length, 0, 0, size};
Point(4) = {length, thick, 0, size};
Point(5) = {0.75 * length, thick, 0, size};
Point(6) = {0, thick - air, 0, size};
Point(7) = {length, 2 * thick, 0, size};
Point(8) = {0, 2 * thick, 0, size};
Point(9) = {0, thick + air, 0, size};

Line(1) = {1, 2};
Line(2) = {2, 3};
Line(3) = {3, 4};
Line(4) = {4, 5};
Line(5) = {5, 6};
Line(6) = {6, 1};
Line(7) = {4, 7};
Line(8) = {7, 8};
Line(9) = {8, 9};
Line(10) = {9, 5};

Curve Loop(1) = {1, 2, 3, 4, 5, 6};
Plane Surface(1) = {1};
Curve Loop(2) = {-4, 7, 8, 9, 10};
Plane Surface(2) = {2};

lower[] = Extrude {0, 0, width} { Surface{1}; };  // the far side, the volume, then along 1, 2, ...
upper[] = Extrude {0, 0, width} { Surface{2}; };

Physical Volume("beams", 1) = {lower[1], upper[1]};
Physical Surface("clamp", 2) = {lower[7], upper[5]};
Physical Surface("crack", 3) = {lower[5]};
Physical Surface("pressed", 4) = {lower[3]};

Mesh.ElementOrder = 2;
