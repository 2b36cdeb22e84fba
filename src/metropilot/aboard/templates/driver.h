/* @TITLE@
 *
 * @ABOUT@
 *
 * SI units throughout. Call @NAME@_init once, then @NAME@_step once in every control period of
 * @PERIOD@ s. A caller keeps the state; there is no other memory, no allocation, no recursion, and every loop
 * has a fixed bound. A measurement that is lost is NaN: the emergency brake follows, as it does on a speed below zero
 * (by more than 0.05 m/s and the error declared for it) and on a position before the map. Other numbers are trusted.
 */
#ifndef @GUARD@_H
#define @GUARD@_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

typedef @REAL@ @NAME@_real;

/* Sections, by the number that @NAME@_init takes. */
enum {
@ENUM@
    @GUARD@_SECTIONS = @COUNT@
};

typedef struct {
    const char *origin, *destination;
    @NAME@_real length_m;    /* from the origin to the stop */
    @NAME@_real scheduled_s; /* scheduled running time of the line; 0: none is known */
} @NAME@_section;

extern const @NAME@_section @NAME@_sections[@GUARD@_SECTIONS];

/* Measurements at the beginning of a control period. */
typedef struct {
    @NAME@_real time_s;            /* since departure */
    @NAME@_real position_m;        /* head of the trainset, from the section's origin */
    @NAME@_real speed_mps;         /* measured; below zero only by what odometry errs */
    @NAME@_real acceleration_mps2; /* over the last period */
    @NAME@_real scheduled_s;       /* running time in force; it may change on the way */
} @NAME@_input;

/* What reaches the trainset in the coming period. */
typedef struct {
    @NAME@_real share;         /* traction above 0, braking below, of the force available: -1 to 1 */
    bool emergency;            /* emergency brake, whatever share says */
    int32_t level;             /* 0: the command passed, 1: traction cut off, 2: service brake, 3: emergency */
    @NAME@_real permitted_mps; /* permitted speed here */
    @NAME@_real emergency_mps; /* speed of the emergency braking curve here */
    bool valid;                /* the command asked for was a number from -1 to 1 */
} @NAME@_output;

/* Memory between two periods: of the policy, and of protection. */
typedef struct {
    int32_t section;
    struct {
@POLICY@
    } policy;
    struct {
@PROTECTION@
    } protection;
} @NAME@_state;

/* State at departure. Returns 0, or -1 where there is no such section (the state is then not changed). */
int @NAME@_init(@NAME@_state *state, int32_t section);

/* One control period: the driver decides, protection has the last word. */
void @NAME@_step(@NAME@_state *state, const @NAME@_input *input, @NAME@_output *output);

/* One control period by hand: protection alone, on a command of the caller.
 * emergency: the caller asks for the emergency brake. */
void @NAME@_supervise(@NAME@_state *state, const @NAME@_input *input, @NAME@_real share, bool emergency,
    @NAME@_output *output);

#ifdef __cplusplus
}
#endif

#endif
