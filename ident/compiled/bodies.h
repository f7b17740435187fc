/* Inertia and torques of a tree of bodies: spatial vectors in the axes of the base about the origin of the first joint,
 * angular part first (R. Featherstone, Rigid Body Dynamics Algorithms, 2008, tables 5.1 and 6.2). */
#ifndef DYNID_BODIES_H
#define DYNID_BODIES_H

#include "arm.h"
#include "vectors.h"

struct body {
    double rotation[9], origin[3], axis[6], mass, moment[3], inertia[6]; /* xx xy xz yy yz zz */
};

static void place(const struct tree *tree, const double *inertial, const double *position, struct body *bodies)
{
    for (int joint = 0; joint < tree->joints; joint++, inertial += 10) {
        struct body *own = bodies + joint;
        const double *turn = tree->turns + 27 * joint, *axis = tree->axis + 3 * joint;
        const struct body *before = bodies + tree->parent[joint];
        int root = tree->parent[joint] < 0, slides = tree->prismatic[joint];
        double back[9], offset[3], along[3], sine = slides ? 0.0 : sin(position[joint]);
        double cosine = slides ? 0.0 : cos(position[joint]);
        for (int i = 0; i < 9; i++)
            back[i % 3 * 3 + i / 3] = turn[i] + turn[9 + i] * sine + turn[18 + i] * cosine;
        times(back, axis, along);
        for (int i = 0; i < 3; i++) {
            offset[i] = tree->translation[3 * joint + i] + (slides ? along[i] * position[joint] : 0.0);
            if (root)
                offset[i] -= tree->translation[i];
        }
        if (root) {
            memcpy(own->rotation, back, sizeof back);
            memcpy(own->origin, offset, sizeof offset);
        } else {
            product(before->rotation, back, own->rotation);
            times(before->rotation, offset, own->origin);
            for (int i = 0; i < 3; i++)
                own->origin[i] += before->origin[i];
        }
        const double *r = own->rotation, *p = own->origin;
        times(r, axis, along);
        memset(own->axis, 0, sizeof own->axis);
        memcpy(slides ? own->axis + 3 : own->axis, along, sizeof along);
        if (!slides)
            cross(p, along, own->axis + 3);
        const double *t = inertial;
        double tensor[9] = {t[0], t[1], t[2], t[1], t[3], t[4], t[2], t[4], t[5]}, turned[9], h[3];
        own->mass = t[9];
        times(r, t + 6, h);
        product(r, tensor, turned);
        double lifted = 2.0 * dot(3, p, h) + own->mass * dot(3, p, p);
        for (int i = 0, slot = 0; i < 3; i++) {
            own->moment[i] = h[i] + own->mass * p[i];
            for (int j = i; j < 3; j++, slot++)
                own->inertia[slot] = dot(3, turned + 3 * i, r + 3 * j) - p[i] * h[j] - h[i] * p[j]
                                     - own->mass * p[i] * p[j] + (i == j ? lifted : 0.0);
        }
    }
}

/* Force of a body for a motion: (moment, force) of I v. */
static void moved(const struct body *body, const double *v, double *out)
{
    const double *w = v, *l = v + 3, *h = body->moment, *i = body->inertia;
    cross(h, l, out);
    out[0] += i[0] * w[0] + i[1] * w[1] + i[2] * w[2];
    out[1] += i[1] * w[0] + i[3] * w[1] + i[4] * w[2];
    out[2] += i[2] * w[0] + i[4] * w[1] + i[5] * w[2];
    cross(w, h, out + 3);
    for (int k = 0; k < 3; k++)
        out[3 + k] += body->mass * l[k];
}

static void tree_inertia(const struct tree *tree, const struct body *bodies, double *matrix)
{
    int count = tree->joints;
    struct body whole[count];
    memcpy(whole, bodies, sizeof whole);
    memset(matrix, 0, sizeof(double) * (unsigned)(count * count));
    for (int joint = count - 1; joint >= 0; joint--) {
        struct body *own = whole + joint;
        double force[6];
        moved(own, own->axis, force);
        for (int other = joint; other >= 0; other = tree->parent[other])
            matrix[joint * count + other] = matrix[other * count + joint] = dot(6, bodies[other].axis, force);
        if (tree->parent[joint] >= 0) {
            struct body *before = whole + tree->parent[joint];
            before->mass += own->mass;
            for (int i = 0; i < 6; i++) {
                before->inertia[i] += own->inertia[i];
                before->moment[i % 3] += i < 3 ? own->moment[i] : 0.0;
            }
        }
    }
}

/* Torques (n,) of the tree's joints for rates and accelerations (n,); null accelerations are 0. */
static void tree_torque(const struct tree *tree, const struct body *bodies, const double *rate, const double *faster,
                        double *torque)
{
    int count = tree->joints;
    double velocity[count][6], acceleration[count][6], force[count][6];
    for (int joint = 0; joint < count; joint++) {
        const struct body *own = bodies + joint;
        double *v = velocity[joint], *a = acceleration[joint], *f = force[joint], change[6], turned[3];
        int parent = tree->parent[joint];
        for (int i = 0; i < 6; i++) {
            v[i] = parent < 0 ? 0.0 : velocity[parent][i];
            a[i] = parent < 0 ? (i < 3 ? 0.0 : -tree->gravity[i - 3]) : acceleration[parent][i];
            change[i] = own->axis[i] * rate[joint];
            if (faster)
                a[i] += own->axis[i] * faster[joint];
        }
        cross(v, change, turned);
        for (int i = 0; i < 3; i++)
            a[i] += turned[i];
        cross(v, change + 3, turned);
        for (int i = 0; i < 3; i++)
            a[3 + i] += turned[i];
        cross(v + 3, change, turned);
        for (int i = 0; i < 3; i++)
            a[3 + i] += turned[i];
        for (int i = 0; i < 6; i++)
            v[i] += change[i];
        moved(own, v, change);
        moved(own, a, f);
        cross(v, change, turned);
        for (int i = 0; i < 3; i++)
            f[i] += turned[i];
        cross(v + 3, change + 3, turned);
        for (int i = 0; i < 3; i++)
            f[i] += turned[i];
        cross(v, change + 3, turned);
        for (int i = 0; i < 3; i++)
            f[3 + i] += turned[i];
    }
    for (int joint = count - 1; joint >= 0; joint--) {
        torque[joint] = dot(6, bodies[joint].axis, force[joint]);
        for (int i = 0; i < 6 && tree->parent[joint] >= 0; i++)
            force[tree->parent[joint]][i] += force[joint][i];
    }
}

#endif
