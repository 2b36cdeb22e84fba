/* Check of the test vectors: the measurements of drives in Python, period by period, and its commands. */
#include "@NAME@.h"

#include <math.h>
#include <stdio.h>

#define TOLERANCE @TOLERANCE@
#define SPARED @SPARED@ /* share of the periods whose command may differ by more */

int main(void)
{
    FILE *file = fopen("vectors.csv", "r");
    @NAME@_state state;
    @NAME@_input input;
    @NAME@_output output;
    double section, time_s, position_m, speed_mps, acceleration_mps2, scheduled_s, share, worst = 0.0;
    int level;
    long rows = 0, wrong = 0, other = 0;

    if (file == NULL || fscanf(file, "%*[^\n]") != 0) {
        fprintf(stderr, "vectors.csv: cannot be read\n");
        return 2;
    }
    while (fscanf(file, "%lf,%lf,%lf,%lf,%lf,%lf,%lf,%d", &section, &time_s, &position_m, &speed_mps,
               &acceleration_mps2, &scheduled_s, &share, &level) == 8) {
        double error;
        if (time_s <= 0.0 && @NAME@_init(&state, (int32_t)section) != 0) break;
        input.time_s = (@NAME@_real)time_s;
        input.position_m = (@NAME@_real)position_m;
        input.speed_mps = (@NAME@_real)speed_mps;
        input.acceleration_mps2 = (@NAME@_real)acceleration_mps2;
        input.scheduled_s = (@NAME@_real)scheduled_s;
        @NAME@_step(&state, &input, &output);
        error = fabs((double)output.share - share);
        worst = error > worst ? error : worst;
        wrong += !(error <= TOLERANCE);
        other += output.level != level;
        rows++;
    }
    fclose(file);
    printf("%ld periods, %ld wrong, largest difference of a command %.1e; %ld other verdicts\n", rows, wrong, worst,
        other);
    return rows > 0 && (double)wrong <= SPARED * (double)rows && other == 0 ? 0 : 1;
}
