/* @TITLE@
 *
 * @ABOUT@
 * Written from the functions that Python runs; not to be changed by hand. Compile without contraction of
 * products and sums (-ffp-contract=off), so that the numbers are those of Python.
 */
#include "@NAME@.h"

#include <math.h>
#include <string.h>

#ifdef __clang__
#pragma STDC FP_CONTRACT OFF
#endif

@PREAMBLE@

@TABLES@

const @NAME@_section @NAME@_sections[@GUARD@_SECTIONS] = {
@SECTIONS@
};

int @NAME@_init(@NAME@_state *state, int32_t section)
{
    if (section < 0 || section >= @GUARD@_SECTIONS) return -1;
    memset(state, 0, sizeof *state);
    state->section = section;
@INIT@
    return 0;
}

/* The command that the driver asks for. */
@DECIDE@

void @NAME@_supervise(@NAME@_state *state, const @NAME@_input *input, @NAME@_real share, bool emergency,
    @NAME@_output *output)
{
    int32_t level;
@SUPERVISE@
    output->level = level;
}

void @NAME@_step(@NAME@_state *state, const @NAME@_input *input, @NAME@_output *output)
{
    @NAME@_supervise(state, input, decide(state, input), false, output);
}
