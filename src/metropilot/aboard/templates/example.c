/* Example: @NAME@ drives a section against a small plant.
 *
 *     make && ./example [SECTION [SCHEDULED_S]]
 *
 * On a controller the plant is the trainset: read odometry and clock where this reads the plant, and send
 * output.share and output.emergency to traction and brakes.
 */
#include "@NAME@.h"
#include "plant.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#define STANDING_S 2.0
#define LONGEST_S 1800.0

static void read_plant(const plant_state *plant, @NAME@_input *input)
{
    input->time_s = plant->time_s;
    input->position_m = plant->position_m;
    input->speed_mps = plant->speed_mps;
    input->acceleration_mps2 = plant->acceleration_mps2;
}

int main(int count, char **words)
{
    const int32_t section = count > 1 ? (int32_t)strtol(words[1], NULL, 10) : 0;
    @NAME@_state state;
    @NAME@_input input;
    @NAME@_output output;
    plant_state plant;
    double standing_s = 0.0, error_m;
    long periods = 0, overruled = 0;

    if (@NAME@_init(&state, section) != 0) {
        fprintf(stderr, "section: %ld, allowed 0 to %d\n", (long)section, @GUARD@_SECTIONS - 1);
        return 2;
    }
    plant_init(&plant, section);
    input.scheduled_s = count > 2 ? (@NAME@_real)strtod(words[2], NULL) : @NAME@_sections[section].scheduled_s;
    if (!(input.scheduled_s > 0)) {
        fprintf(stderr, "scheduled running time, s: must be above 0\n");
        return 2;
    }
    printf("%s to %s, %.1f m in %.1f s\n", @NAME@_sections[section].origin, @NAME@_sections[section].destination,
        (double)@NAME@_sections[section].length_m, (double)input.scheduled_s);
    printf("time_s,position_m,speed_mps,command,level,permitted_mps\n");

    while (standing_s < STANDING_S && (double)plant.time_s < LONGEST_S) {
        read_plant(&plant, &input);
        @NAME@_step(&state, &input, &output);
        if (periods++ % 25 == 0) {
            printf("%.1f,%.3f,%.3f,%.3f,%ld,%.3f\n", (double)input.time_s, (double)input.position_m,
                (double)input.speed_mps, (double)output.share, (long)output.level, (double)output.permitted_mps);
        }
        overruled += output.level > 0;
        plant_step(&plant, output.share, output.emergency);
        standing_s = plant.speed_mps > 0 || plant.time_s < 5 ? 0.0 : standing_s + @PERIOD@;
    }

    error_m = (double)plant.position_m - (double)@NAME@_sections[section].length_m;
    printf("stopped %.3f m from the stop after %.2f s, %ld of %ld periods overruled\n", error_m,
        (double)plant.time_s - standing_s, overruled, periods);
    return fabs(error_m) <= 0.3 ? 0 : 1;
}
