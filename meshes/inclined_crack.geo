// A tapered plate with an inclined edge crack, as a pattern for meshes of one's own.
// Make the mesh beside it with:  gmsh -2 -format msh41 meshes/inclined_crack.geo
// The lips are two curves in the same place that share only the tip; transfinite divisions give
// both the same nodes. The ligament is a curve, too, so that each lip bounds a surface of its own.
// Other cracks:  gmsh -2 -format msh41 -setnumber tip 0.03 meshes/inclined_crack.geo -o other.msh

DefineConstant[
    tip = {0.04, Name "tip"},      // m, on the line from the mouth to (0.04, 0.05)
    size = {0.008, Name "size"},     // m, away from the crack
    whole = {0, Name "whole"}        // 1: without a crack
];
lips = 8;           // elements along each lip

Point(1) = {0.00, 0.00, 0, size};
Point(2) = {0.10, 0.00, 0, size};
Point(3) = {0.09, 0.12, 0, size};
Point(4) = {0.01, 0.12, 0, size};
Point(5) = {0.00500, 0.060, 0, size};      // mouth, lower side: on the left edge
Point(6) = {0.00500, 0.060, 0, size};      // mouth, upper side: the same place
Point(7) = {tip, 0.060 - (tip - 0.005) * 10 / 35, 0, size / 6};
Point(8) = {0.09600, 0.048, 0, size};      // where the ligament meets the right edge

Line(1) = {1, 2};
Line(2) = {2, 8};
Line(3) = {8, 3};
Line(4) = {3, 4};
Line(5) = {4, whole ? 5 : 6};
Line(6) = {5, 1};
Line(7) = {5, 7};    // lower lip
Line(9) = {7, 8};    // ligament
Transfinite Curve {7} = lips + 1 Using Progression 0.85;
If (!whole)
    Line(8) = {6, 7};    // upper lip
    Transfinite Curve {8} = lips + 1 Using Progression 0.85;
EndIf

Curve Loop(1) = {1, 2, -9, -7, 6};
Plane Surface(1) = {1};
Curve Loop(2) = {9, 3, 4, 5, whole ? 7 : 8};
Plane Surface(2) = {2};

Physical Surface("plate", 1) = {1, 2};
Physical Curve("clamp", 2) = {1};
If (!whole)
    Physical Curve("lower_lip", 3) = {7};
    Physical Curve("upper_lip", 4) = {8};
EndIf
Physical Point("load", 5) = {3};
