/* Plant for the example, written from the functions that Python runs; not to be changed by hand. */
#include "plant.h"

#include <math.h>
#include <string.h>

#ifdef __clang__
#pragma STDC FP_CONTRACT OFF
#endif

@PREAMBLE@

@TABLES@

void plant_init(plant_state *plant, int32_t section)
{
    memset(plant, 0, sizeof *plant);
    plant->section = section;
}

void plant_step(plant_state *plant, @REAL@ share, bool emergency)
{
@MOVE@
}
