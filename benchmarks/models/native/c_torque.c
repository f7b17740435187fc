/* CPU nanoseconds of a call of ARM_torque, and the sum of all torques: c_torque STATES_FILE COUNT ROUNDS.
 * The file holds COUNT times q, dq, ddq as doubles. ARM and HEADER are given by -D. */
#include HEADER

#include <stdio.h>
#include <stdlib.h>
#include <time.h>

int main(int argc, char **argv)
{
    if (argc != 4) {
        return 2;
    }
    const size_t count = (size_t)atol(argv[2]);
    const long rounds = atol(argv[3]);
    double(*states)[3][JOINTS] = malloc(count * sizeof *states);
    FILE *file = fopen(argv[1], "rb");
    if (states == NULL || file == NULL || fread(states, sizeof *states, count, file) != count) {
        return 2;
    }
    fclose(file);
    double sum = 0.0, tau[JOINTS];
    const clock_t start = clock();
    for (long round = 0; round < rounds; round++) {
        for (size_t i = 0; i < count; i++) {
            TORQUE(states[i][0], states[i][1], states[i][2], tau);
            for (int joint = 0; joint < JOINTS; joint++) {
                sum += tau[joint];
            }
        }
    }
    const double seconds = (double)(clock() - start) / CLOCKS_PER_SEC;
    printf("%.17g %.17g\n", 1e9 * seconds / ((double)rounds * (double)count), sum / (double)rounds);
    free(states);
    return 0;
}
