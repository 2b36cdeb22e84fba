/* Plugin of BVE and OpenBVE (ATS interface, version 2.0): @NAME@ drives, or guards the driver's handles.
 *
 * A beacon of type BEACON at each stop says in its data which section begins there; closing the doors begins the
 * run. Key S changes between automatic driving and driving by hand. The plugin works every @PERIOD@ s of the
 * simulator's time and holds its handles in between.
 */
#include "@NAME@.h"

#include <math.h>

#ifdef _WIN32
#define ATS(type) __declspec(dllexport) type __stdcall
#else
#define ATS(type) type
#endif

#define ATS_VERSION 0x00020000
#define BEACON 300
#define KEY_S 0
#define LAMP_AUTOMATIC 200 /* panel entries: 1 while it drives by itself; level; permitted speed, km/h */
#define LAMP_LEVEL 201
#define LAMP_PERMITTED 202
#define KMH 3.6

typedef struct { int brake_notches, power_notches, ats_notch, b67_notch, cars; } ats_spec;
typedef struct {
    double location_m;
    float speed_kmh;
    int time_ms;
    float bc, mr, er, bp, sap, current;
} ats_vehicle;
typedef struct { int type, signal; float distance_m; int optional; } ats_beacon;
typedef struct { int brake, power, reverser, constant_speed; } ats_handles;

static struct {
    ats_spec spec;
    @NAME@_state state;
    @NAME@_input input;
    @NAME@_output output;
    bool automatic, running, starting;
    int next, power, brake, reverser, began_ms, done_ms;
    double origin_m, speed_mps;
} here;

ATS(void) Load(void);
ATS(void) Load(void) { here.automatic = true; }
ATS(void) Dispose(void);
ATS(void) Dispose(void) {}
ATS(int) GetPluginVersion(void);
ATS(int) GetPluginVersion(void) { return ATS_VERSION; }
ATS(void) SetVehicleSpec(ats_spec spec);
ATS(void) SetVehicleSpec(ats_spec spec) { here.spec = spec; }
ATS(void) Initialize(int brake);
ATS(void) Initialize(int brake) { (void)brake; here.running = here.starting = false; }
ATS(void) SetPower(int notch);
ATS(void) SetPower(int notch) { here.power = notch; }
ATS(void) SetBrake(int notch);
ATS(void) SetBrake(int notch) { here.brake = notch; }
ATS(void) SetReverser(int position);
ATS(void) SetReverser(int position) { here.reverser = position; }
ATS(void) KeyDown(int key);
ATS(void) KeyDown(int key) { if (key == KEY_S) here.automatic = !here.automatic; }
ATS(void) KeyUp(int key);
ATS(void) KeyUp(int key) { (void)key; }
ATS(void) HornBlow(int kind);
ATS(void) HornBlow(int kind) { (void)kind; }
ATS(void) DoorOpen(void);
ATS(void) DoorOpen(void) { here.running = here.starting = false; }
ATS(void) DoorClose(void);
ATS(void) DoorClose(void) { here.starting = true; }
ATS(void) SetSignal(int signal);
ATS(void) SetSignal(int signal) { (void)signal; }
ATS(void) SetBeaconData(ats_beacon beacon);
ATS(void) SetBeaconData(ats_beacon beacon) { if (beacon.type == BEACON) here.next = beacon.optional; }

/* One period of driver or guard, on what the simulator measures. */
static void work(const ats_vehicle *vehicle)
{
    const double speed_mps = fabs((double)vehicle->speed_kmh) / KMH;
    const bool first = vehicle->time_ms == here.began_ms;
    here.input.time_s = (@NAME@_real)((vehicle->time_ms - here.began_ms) / 1000.0);
    here.input.position_m = (@NAME@_real)(vehicle->location_m - here.origin_m);
    here.input.speed_mps = (@NAME@_real)speed_mps;
    here.input.acceleration_mps2 = (@NAME@_real)(first ? 0.0 : (speed_mps - here.speed_mps) / @PERIOD@);
    here.speed_mps = speed_mps;
    if (here.automatic) {
        @NAME@_step(&here.state, &here.input, &here.output);
    } else {
        const double share = here.brake > 0 ? -(double)here.brake / here.spec.brake_notches
                                            : (double)here.power / here.spec.power_notches;
        const bool emergency = here.brake > here.spec.brake_notches;
        @NAME@_supervise(&here.state, &here.input, (@NAME@_real)fmax(share, -1.0), emergency, &here.output);
    }
}

ATS(ats_handles) Elapse(ats_vehicle vehicle, int *panel, int *sound);
ATS(ats_handles) Elapse(ats_vehicle vehicle, int *panel, int *sound)
{
    ats_handles handles = {here.brake, here.power, here.reverser, 0};
    const int period_ms = (int)(1000.0 * @PERIOD@ + 0.5);
    (void)sound;
    if (here.starting && @NAME@_init(&here.state, here.next) == 0) {
        here.starting = false;
        here.running = true;
        here.origin_m = vehicle.location_m;
        here.began_ms = vehicle.time_ms;
        here.done_ms = vehicle.time_ms - period_ms;
        here.input.scheduled_s = @NAME@_sections[here.next].scheduled_s;
    }
    if (!here.running) return handles;
    if (vehicle.time_ms - here.done_ms >= period_ms) {
        here.done_ms += period_ms;
        work(&vehicle);
    }
    panel[LAMP_AUTOMATIC] = here.automatic;
    panel[LAMP_LEVEL] = (int)here.output.level;
    panel[LAMP_PERMITTED] = (int)(KMH * (double)here.output.permitted_mps);
    if (here.automatic || here.output.level > 0) {
        /* notches to the safe side: traction rounded down, braking up */
        const double share = (double)here.output.share;
        handles.power = share > 0.0 ? (int)(share * here.spec.power_notches) : 0;
        handles.brake = share < 0.0 ? (int)ceil(-share * here.spec.brake_notches) : 0;
        if (here.output.emergency) handles.brake = here.spec.brake_notches + 1;
    }
    return handles;
}
