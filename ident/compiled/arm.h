/* What both kernels know of an arm: the tree of its joints. Structures as in ident/compiled/library.py. */
#ifndef DYNID_ARM_H
#define DYNID_ARM_H

struct tree {
    int joints;
    const int *parent;         /* number of the joint before, -1 for the base; parents come first */
    const int *prismatic;
    const double *turns;       /* (n, 3, 9) A, B, C of the rotation parent to joint = A + B sin q + C cos q */
    const double *translation; /* (n, 3) origin in the parent's frame, of a prismatic joint at 0 [m] */
    const double *axis;        /* (n, 3) in the joint's frame */
    const double *gravity;     /* (3,) [m/s^2] */
};

#endif
