/* Door of @NAME@ for JavaScript: one driver and one plant, numbers in and out. */
#include "@NAME@.h"
#include "plant.h"

static @NAME@_state state;
static @NAME@_input input;
static @NAME@_output output;
static plant_state plant;

#define DOOR(type, name, arguments) \
    type door_##name arguments;     \
    __attribute__((export_name(#name))) type door_##name arguments

/* Driver and plant at the origin of a section. Returns 0, or -1 where there is no such section. */
DOOR(int32_t, reset, (int32_t section))
{
    if (@NAME@_init(&state, section) != 0) return -1;
    plant_init(&plant, section);
    return 0;
}

/* Measurements of the next period. */
DOOR(void, measure,
    (double time_s, double position_m, double speed_mps, double acceleration_mps2, double scheduled_s))
{
    input.time_s = (@NAME@_real)time_s;
    input.position_m = (@NAME@_real)position_m;
    input.speed_mps = (@NAME@_real)speed_mps;
    input.acceleration_mps2 = (@NAME@_real)acceleration_mps2;
    input.scheduled_s = (@NAME@_real)scheduled_s;
}

/* The driver decides, protection has the last word. */
DOOR(void, step, (void)) { @NAME@_step(&state, &input, &output); }

/* Protection alone, on a command of the caller. */
DOOR(void, supervise, (double share, int32_t emergency))
{
    @NAME@_supervise(&state, &input, (@NAME@_real)share, emergency != 0, &output);
}

/* The plant follows the last answer for one period. */
DOOR(void, move, (void)) { plant_step(&plant, output.share, output.emergency); }

/* Permitted speed at a place of a section; the state is left as it is. */
DOOR(double, permitted, (int32_t section, double position_m))
{
    @NAME@_state other;
    @NAME@_input place = {0};
    @NAME@_output answer;
    if (@NAME@_init(&other, section) != 0) return 0.0;
    place.position_m = (@NAME@_real)position_m;
    @NAME@_supervise(&other, &place, 0, false, &answer);
    return (double)answer.permitted_mps;
}

DOOR(double, share, (void)) { return (double)output.share; }
DOOR(int32_t, emergency, (void)) { return output.emergency; }
DOOR(int32_t, level, (void)) { return output.level; }
DOOR(double, permitted_mps, (void)) { return (double)output.permitted_mps; }
DOOR(int32_t, interventions, (void)) { return state.protection.interventions; }
DOOR(double, time_s, (void)) { return (double)plant.time_s; }
DOOR(double, position_m, (void)) { return (double)plant.position_m; }
DOOR(double, speed_mps, (void)) { return (double)plant.speed_mps; }
DOOR(double, acceleration_mps2, (void)) { return (double)plant.acceleration_mps2; }
DOOR(double, traction_j, (void)) { return (double)plant.traction_j; }
