/* Of many samples, LANES at a time: the packed rows of the links' parameters in the regressor (ident/model/regressor.py,
 * whose formulas these are), and the torques that given links need. Motion in the axes of the base, then turned into
 * each link's frame. */
#include <math.h>
#include <string.h>

#include "arm.h"

#define LANES 4
typedef double lanes __attribute__((vector_size(8 * LANES)));
#define INLINE static inline __attribute__((always_inline))
typedef long long whole __attribute__((vector_size(8 * LANES)));

struct rows {
    const int *kinds_from; /* (n + 1,) where each link's kinds begin */
    const int *kinds;      /* which of the ten parameters, in the order of the rows */
    int targets;
    const int *target;     /* (targets, 4) link, first row, first axis, number of axes; ordered by link */
    const int *axis_joint;
    const int *axis_share; /* row of `shares` that holds the factor; -1: the number in axis_factor */
    const double *axis_factor;
};

INLINE lanes taken(const double *row, int count)
{
    lanes values = {0};
    if (count == LANES)
        memcpy(&values, row, sizeof values);
    else
        memcpy(&values, row, sizeof(double) * (unsigned)count);
    return values;
}

INLINE void put(double *row, lanes values, int count)
{
    if (count == LANES)
        memcpy(row, &values, sizeof values);
    else
        memcpy(row, &values, sizeof(double) * (unsigned)count);
}

/* Sine and cosine: the angle less the nearest multiple of pi/2, in three parts, then the polynomials of the Cephes
 * library (S. L. Moshier, 1989), exact to an ulp or two; angles beyond 1e5 and what is no number by the C library. */
INLINE void turn_of(lanes angle, lanes *sine, lanes *cosine)
{
    const double magic = 6755399441055744.0; /* 1.5 * 2^52: adding it rounds, and leaves the whole number below */
    lanes shifted = angle * 0.63661977236758134308 + magic, quarters = shifted - magic;
    lanes x = angle - quarters * 1.57079625129699707031 - quarters * 7.54978941586159635335e-8;
    x -= quarters * 5.39030285815811905290e-15;
    lanes z = x * x;
    lanes s = x + x * z * (((((1.58962301576546568060e-10 * z - 2.50507477628578072866e-8) * z
                              + 2.75573136213857245213e-6) * z - 1.98412698295895385996e-4) * z
                            + 8.33333333332211858878e-3) * z - 1.66666666666666307295e-1);
    lanes c = 1.0 - 0.5 * z + z * z * (((((2.08757008419747316778e-9 - 1.13585365213876817300e-11 * z) * z
                                          - 2.75573141792967388112e-7) * z + 2.48015872888517045348e-5) * z
                                        - 1.38888888888730564116e-3) * z + 4.16666666666665929218e-2);
    whole quarter = (whole)shifted, odd = -(quarter & 1), bits_s = (whole)s, bits_c = (whole)c;
    *sine = (lanes)(((bits_c & odd) | (bits_s & ~odd)) ^ ((quarter & 2) << 62));
    *cosine = (lanes)(((bits_s & odd) | (bits_c & ~odd)) ^ (((quarter + 1) & 2) << 62));
    for (int lane = 0; lane < LANES; lane++)
        if (!(fabs(angle[lane]) < 1e5))
            (*sine)[lane] = sin(angle[lane]), (*cosine)[lane] = cos(angle[lane]);
}

INLINE void cross(const lanes *a, const lanes *b, lanes *out)
{
    lanes x = a[1] * b[2] - a[2] * b[1], y = a[2] * b[0] - a[0] * b[2], z = a[0] * b[1] - a[1] * b[0];
    out[0] = x, out[1] = y, out[2] = z;
}

/* R^T v */
INLINE void into(const lanes *rotation, const lanes *vector, lanes *out)
{
    for (int i = 0; i < 3; i++)
        out[i] = rotation[i] * vector[0] + rotation[3 + i] * vector[1] + rotation[6 + i] * vector[2];
}

struct link {
    lanes rotation[9]; /* link to base */
    lanes origin[3], axis[3], angular[3], change[3], linear[3];
};

INLINE void place(const struct tree *tree, int joint, struct link *links, lanes position, lanes rate,
                         lanes acceleration)
{
    struct link *own = links + joint;
    const double *turn = tree->turns + 27 * joint, *shift = tree->translation + 3 * joint, *axis = tree->axis + 3 * joint;
    int parent = tree->parent[joint], prismatic = tree->prismatic[joint];
    lanes turned[9], arm[3], moved[3], swing[3], sine = position, cosine = position;
    if (!prismatic)
        turn_of(position, &sine, &cosine);
    for (int i = 0; i < 9; i++)
        turned[i] = prismatic ? turn[i] + 0.0 * sine : turn[i] + turn[9 + i] * sine + turn[18 + i] * cosine;
    for (int i = 0; i < 3; i++) {
        double along = turn[i] * axis[0] + turn[3 + i] * axis[1] + turn[6 + i] * axis[2];
        arm[i] = prismatic ? shift[i] + along * position : shift[i] + 0.0 * position;
    }
    if (parent < 0) {
        for (int i = 0; i < 3; i++) {
            for (int j = 0; j < 3; j++)
                own->rotation[3 * i + j] = turned[3 * j + i];
            own->origin[i] = arm[i];
            own->angular[i] = own->change[i] = 0.0 * sine;
            own->linear[i] = own->angular[i] - tree->gravity[i];
        }
    } else {
        const struct link *before = links + parent;
        for (int i = 0; i < 3; i++) {
            const lanes *row = before->rotation + 3 * i;
            for (int j = 0; j < 3; j++)
                own->rotation[3 * i + j] = row[0] * turned[3 * j] + row[1] * turned[3 * j + 1] + row[2] * turned[3 * j + 2];
            moved[i] = row[0] * arm[0] + row[1] * arm[1] + row[2] * arm[2];
            own->origin[i] = before->origin[i] + moved[i];
            own->angular[i] = before->angular[i];
            own->change[i] = before->change[i];
        }
        cross(before->angular, moved, swing);
        cross(before->angular, swing, swing);
        cross(before->change, moved, arm);
        for (int i = 0; i < 3; i++)
            own->linear[i] = before->linear[i] + arm[i] + swing[i];
    }
    for (int i = 0; i < 3; i++) {
        const lanes *row = own->rotation + 3 * i;
        own->axis[i] = row[0] * axis[0] + row[1] * axis[1] + row[2] * axis[2];
        moved[i] = own->axis[i] * rate;
    }
    cross(own->angular, moved, swing);
    for (int i = 0; i < 3; i++) {
        if (prismatic) {
            own->linear[i] += own->axis[i] * acceleration + 2.0 * swing[i];
        } else {
            own->change[i] += own->axis[i] * acceleration + swing[i];
            own->angular[i] += moved[i];
        }
    }
}

INLINE void write_rows(const int *kinds, int count, const lanes *w, const lanes *v, const lanes *rate,
                              const lanes *change, const lanes *a, double *out, long stride, int samples)
{
    lanes xx = rate[0] * rate[0], yy = rate[1] * rate[1], zz = rate[2] * rate[2];
    lanes xy = rate[0] * rate[1], xz = rate[0] * rate[2], yz = rate[1] * rate[2];
    lanes moment[3];
    cross(a, w, moment);
    for (int slot = 0; slot < count; slot++) {
        lanes row;
        switch (kinds[slot]) {
        case 0: row = w[0] * change[0] + w[1] * xz - w[2] * xy; break;
        case 1: row = w[0] * (change[1] - xz) + w[1] * (change[0] + yz) + w[2] * (xx - yy); break;
        case 2: row = w[0] * (change[2] + xy) + w[1] * (zz - xx) + w[2] * (change[0] - yz); break;
        case 3: row = w[1] * change[1] - w[0] * yz + w[2] * xy; break;
        case 4: row = w[0] * (yy - zz) + w[1] * (change[2] - xy) + w[2] * (change[1] + xz); break;
        case 5: row = w[0] * yz - w[1] * xz + w[2] * change[2]; break;
        case 6: row = v[1] * (xy + change[2]) - v[0] * (yy + zz) + v[2] * (xz - change[1]) + moment[0]; break;
        case 7: row = v[0] * (xy - change[2]) - v[1] * (xx + zz) + v[2] * (yz + change[0]) + moment[1]; break;
        case 8: row = v[0] * (xz + change[1]) + v[1] * (yz - change[0]) - v[2] * (xx + yy) + moment[2]; break;
        default: row = v[0] * a[0] + v[1] * a[1] + v[2] * a[2];
        }
        put(out + stride * slot, row, samples);
    }
}

INLINE void motor_axis(const struct tree *tree, const struct rows *rows, const int *entry, const struct link *links,
                              const double *shares, long from, int samples, lanes *w, lanes *v)
{
    const struct link *link = links + entry[0];
    lanes turning[3] = {{0}}, moving[3] = {{0}};
    for (int place = entry[2]; place < entry[2] + entry[3]; place++) {
        int joint = rows->axis_joint[place], row = rows->axis_share[place];
        const struct link *of = links + joint;
        lanes axis[3], arm[3];
        for (int i = 0; i < 3; i++) {
            axis[i] = of->axis[i];
            if (row >= 0)
                axis[i] *= taken(shares + from * row, samples);
            else if (rows->axis_factor[place] != 1.0)
                axis[i] *= rows->axis_factor[place];
            arm[i] = link->origin[i] - of->origin[i];
        }
        if (tree->prismatic[joint]) {
            for (int i = 0; i < 3; i++)
                moving[i] += axis[i];
            continue;
        }
        cross(axis, arm, arm);
        for (int i = 0; i < 3; i++) {
            turning[i] += axis[i];
            moving[i] += arm[i];
        }
    }
    into(link->rotation, turning, w);
    into(link->rotation, moving, v);
}

/* Motions of the tree (n, count) and varying shares, `from` doubles from row to row; out `stride`. */
void dynid_rows(const struct tree *tree, const struct rows *rows, int count, long from, const double *position,
                const double *rate, const double *acceleration, const double *shares, double *out, long stride)
{
    struct link links[tree->joints];
    for (int start = 0; start < count; start += LANES) {
        lanes angular[3], change[3], linear[3], w[3], v[3];
        int samples = count - start < LANES ? count - start : LANES, current = -1;
        for (int joint = 0; joint < tree->joints; joint++) {
            long at = from * joint + start;
            place(tree, joint, links, taken(position + at, samples), taken(rate + at, samples),
                  taken(acceleration + at, samples));
        }
        for (int target = 0; target < rows->targets; target++) {
            const int *entry = rows->target + 4 * target;
            const struct link *link = links + entry[0];
            int first = rows->kinds_from[entry[0]], kinds = rows->kinds_from[entry[0] + 1] - first;
            if (entry[0] != current) {
                into(link->rotation, link->angular, angular);
                into(link->rotation, link->change, change);
                into(link->rotation, link->linear, linear);
                current = entry[0];
            }
            motor_axis(tree, rows, entry, links, shares + start, from, samples, w, v);
            write_rows(rows->kinds + first, kinds, w, v, angular, change, linear, out + stride * entry[1] + start, stride,
                       samples);
        }
    }
}

/* R v */
INLINE void outof(const lanes *rotation, const lanes *vector, lanes *out)
{
    for (int i = 0; i < 3; i++)
        out[i] = rotation[3 * i] * vector[0] + rotation[3 * i + 1] * vector[1] + rotation[3 * i + 2] * vector[2];
}

/* Force and moment about its frame's origin that a link with ten parameters needs, in the axes of the base. */
INLINE void wrench(const struct link *link, const double *own, lanes *force, lanes *moment)
{
    lanes w[3], e[3], a[3], spin[3], f[3], n[3], turned[3];
    into(link->rotation, link->angular, w);
    into(link->rotation, link->change, e);
    into(link->rotation, link->linear, a);
    lanes h[3] = {own[6] + 0.0 * w[0], own[7] + 0.0 * w[0], own[8] + 0.0 * w[0]};
    cross(w, h, f);
    cross(w, f, f);
    cross(e, h, turned);
    for (int i = 0; i < 3; i++)
        f[i] += own[9] * a[i] + turned[i];
    const int place[9] = {0, 1, 2, 1, 3, 4, 2, 4, 5};
    for (int i = 0; i < 3; i++) {
        const int *row = place + 3 * i;
        spin[i] = own[row[0]] * w[0] + own[row[1]] * w[1] + own[row[2]] * w[2];
        n[i] = own[row[0]] * e[0] + own[row[1]] * e[1] + own[row[2]] * e[2];
    }
    cross(w, spin, spin);
    cross(h, a, turned);
    for (int i = 0; i < 3; i++)
        n[i] += spin[i] + turned[i];
    outof(link->rotation, f, force);
    outof(link->rotation, n, moment);
}

/* Torques (n, count) of the tree's joints, all rows `from` doubles apart; inertial (n, 10) of the links. */
void dynid_torques(const struct tree *tree, const double *inertial, int count, long from, const double *position,
                   const double *rate, const double *acceleration, double *out)
{
    struct link links[tree->joints];
    lanes force[tree->joints][3], moment[tree->joints][3];
    for (int start = 0; start < count; start += LANES) {
        int samples = count - start < LANES ? count - start : LANES;
        for (int joint = 0; joint < tree->joints; joint++) {
            long at = from * joint + start;
            place(tree, joint, links, taken(position + at, samples), taken(rate + at, samples),
                  taken(acceleration + at, samples));
            wrench(links + joint, inertial + 10 * joint, force[joint], moment[joint]);
        }
        for (int joint = tree->joints - 1; joint >= 0; joint--) {
            const lanes *axis = links[joint].axis, *along = tree->prismatic[joint] ? force[joint] : moment[joint];
            put(out + from * joint + start, axis[0] * along[0] + axis[1] * along[1] + axis[2] * along[2], samples);
            int parent = tree->parent[joint];
            if (parent < 0)
                continue;
            lanes arm[3], turned[3];
            for (int i = 0; i < 3; i++)
                arm[i] = links[joint].origin[i] - links[parent].origin[i];
            cross(arm, force[joint], turned);
            for (int i = 0; i < 3; i++) {
                force[parent][i] += force[joint][i];
                moment[parent][i] += moment[joint][i] + turned[i];
            }
        }
    }
}
