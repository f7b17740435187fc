/* Vectors (3,), matrices (3, 3) row by row, and small square matrices. */
#ifndef DYNID_VECTORS_H
#define DYNID_VECTORS_H

#include <math.h>
#include <string.h>

enum { DONE, UNSOLVED }; /* what is unsolved, the caller's own code does, or says why it cannot */

static void cross(const double *a, const double *b, double *out)
{
    double x = a[1] * b[2] - a[2] * b[1], y = a[2] * b[0] - a[0] * b[2], z = a[0] * b[1] - a[1] * b[0];
    out[0] = x, out[1] = y, out[2] = z;
}

static double dot(int count, const double *a, const double *b)
{
    double total = 0.0;
    for (int i = 0; i < count; i++)
        total += a[i] * b[i];
    return total;
}

static void times(const double *matrix, const double *vector, double *out) /* (3, 3) */
{
    double x = dot(3, matrix, vector), y = dot(3, matrix + 3, vector), z = dot(3, matrix + 6, vector);
    out[0] = x, out[1] = y, out[2] = z;
}

static void product(const double *a, const double *b, double *out) /* (3, 3), out apart */
{
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            out[3 * i + j] = a[3 * i] * b[j] + a[3 * i + 1] * b[3 + j] + a[3 * i + 2] * b[6 + j];
}

/* The inverse by elimination with row pivots; the sign of the determinant, 0 of a singular matrix. */
static double invert(int count, double *matrix, double *inverse)
{
    double sign = 1.0;
    for (int i = 0; i < count * count; i++)
        inverse[i] = i % (count + 1) == 0;
    for (int column = 0; column < count; column++) {
        int pivot = column;
        for (int row = column + 1; row < count; row++)
            if (fabs(matrix[row * count + column]) > fabs(matrix[pivot * count + column]))
                pivot = row;
        double *own = matrix + column * count, *made = inverse + column * count, head = matrix[pivot * count + column];
        if (!(fabs(head) > 0.0) || isinf(head))
            return 0.0;
        sign *= (head < 0.0) != (pivot != column) ? -1.0 : 1.0;
        for (int i = 0; i < count; i++) {
            double left = own[i], right = made[i];
            own[i] = matrix[pivot * count + i], matrix[pivot * count + i] = left;
            made[i] = inverse[pivot * count + i], inverse[pivot * count + i] = right;
            own[i] /= head, made[i] /= head;
        }
        for (int row = 0; row < count; row++) {
            double factor = matrix[row * count + column];
            if (row == column || factor == 0.0)
                continue;
            for (int i = 0; i < count; i++) {
                matrix[row * count + i] -= factor * own[i];
                inverse[row * count + i] -= factor * made[i];
            }
        }
    }
    return sign;
}

static int positive_definite(int count, const double *matrix)
{
    double lower[count * count];
    for (int row = 0; row < count; row++)
        for (int column = 0; column <= row; column++) {
            double left = matrix[row * count + column] - dot(column, lower + row * count, lower + column * count);
            if (row == column && !(left > 0.0))
                return 0;
            lower[row * count + column] = row == column ? sqrt(left) : left / lower[column * count + column];
        }
    return 1;
}

#endif
