using System;
using System.Collections.Generic;
using System.Runtime.InteropServices;

namespace Hapticnet
{
    /// <summary>What a master asks for. What is null has hapticnet's default.</summary>
    public sealed class Request
    {
        /// <summary>How forces are compressed.</summary>
        public string Codec { get; set; } = "deadband";

        /// <summary>Who asks: printable, at most 64 bytes of UTF-8.</summary>
        public string Name { get; set; } = "C#";

        /// <summary>Parameters of the codec.</summary>
        public IDictionary<string, double> Parameters { get; } = new Dictionary<string, double>();

        /// <summary>The just-noticeable difference of the person, as a fraction of the force. Default: 0.05.</summary>
        public double? WeberFraction { get; set; }

        /// <summary>The smallest just-noticeable difference [N]. Default: 0.025.</summary>
        public double? FloorN { get; set; }

        /// <summary>The threshold in just-noticeable differences. Default: 1.</summary>
        public double? Multiplier { get; set; }

        /// <summary>Positions a second, 20 to 100000. Default: 1000.</summary>
        public double? RateHz { get; set; }

        /// <summary>Number of axes, 1 to 3.</summary>
        public int Axes { get; set; } = 1;

        /// <summary>For few positions, their share of the just-noticeable difference, 0.01 to 0.9. Null: all are sent.
        /// </summary>
        public double? PositionShare { get; set; }

        /// <summary>Whether to render contact that the slave announces.</summary>
        public bool Announced { get; set; }

        /// <summary>Whether the slave predicts the hand.</summary>
        public bool Predicted { get; set; }

        internal IDictionary<string, double> Numbers()
        {
            var numbers = new Dictionary<string, double>(Parameters) { ["axes"] = Axes };
            Add(numbers, "weber_fraction", WeberFraction);
            Add(numbers, "floor_n", FloorN);
            Add(numbers, "multiplier", Multiplier);
            Add(numbers, "rate_hz", RateHz);
            Add(numbers, "position_share", PositionShare);
            Add(numbers, "announced", Announced ? 1.0 : (double?)null);
            Add(numbers, "predicted", Predicted ? 1.0 : (double?)null);
            return numbers;
        }

        private static void Add(IDictionary<string, double> numbers, string name, double? value)
        {
            if (value.HasValue)
                numbers[name] = value.Value;
        }
    }

    /// <summary>Where a master's session stands.</summary>
    public enum SessionState
    {
        /// <summary>It asks for a session.</summary>
        Connecting,

        /// <summary>Positions are answered.</summary>
        Established,

        /// <summary>There has been no answer for 200 ms; the force fades.</summary>
        Stale,

        /// <summary>It says goodbye.</summary>
        Closing,

        /// <summary>It is over.</summary>
        Closed,
    }

    /// <summary>The master's end: positions out, forces back. It does no input or output and reads no clock.</summary>
    /// <remarks>Each period, call <see cref="Tick(double[], long)"/>, <see cref="Force"/> and then <see cref="Send"/>,
    /// until that returns 0; after <see cref="Receive"/>, send too. Times are microseconds of one monotonic clock. One
    /// thread at a time may use it. None of these calls allocates memory.</remarks>
    public sealed class Master : Node
    {
        private readonly MasterHandle _handle;

        /// <summary>Make a master.</summary>
        /// <param name="request">What to ask for.</param>
        /// <param name="random">Returns 32 unpredictable bits. Null: the system's.</param>
        /// <exception cref="HapticException">The request is wrong, or the library is missing.</exception>
        public Master(Request request, Func<uint> random = null)
            : base(request.Axes, random)
        {
            var numbers = request.Numbers();
            var names = new IntPtr[numbers.Count];
            var values = new double[numbers.Count];
            var wrong = new byte[(int)Native.Loaded(Native.hn_error_bytes)];
            try
            {
                int i = 0;
                foreach (var number in numbers)
                {
                    byte[] name = Native.Bytes(number.Key);
                    names[i] = Marshal.AllocHGlobal(name.Length);
                    Marshal.Copy(name, 0, names[i], name.Length);
                    values[i++] = number.Value;
                }
                _handle = Native.Loaded(() => Native.hn_make_master(Native.Bytes(request.Codec),
                    Native.Bytes(request.Name), names, values, (UIntPtr)names.Length, RandomSource.Callback, Context,
                    wrong));
            }
            finally
            {
                foreach (IntPtr name in names)
                    Marshal.FreeHGlobal(name);
                if (_handle == null || _handle.IsInvalid)
                    Abandon();
                else
                    Hand(_handle);
            }
            Native.Check(_handle, wrong);
        }

        /// <summary>Where the session stands.</summary>
        public SessionState State
        {
            get { return (SessionState)Native.hn_master_state(_handle); }
        }

        /// <summary>The name of the slave's scene; empty before the first session.</summary>
        public string Scene
        {
            get { return Native.Text(Native.hn_master_scene(_handle)); }
        }

        /// <summary>Why the slave refused, closed or warned, newest first; empty if it has not.</summary>
        public string Reason
        {
            get
            {
                uint code;
                return Native.Text(Native.hn_master_reason(_handle, out code));
            }
        }

        /// <summary>The code of that reason; 0 is "other", and none.</summary>
        public int ReasonCode
        {
            get
            {
                uint code;
                Native.hn_master_reason(_handle, out code);
                return (int)code;
            }
        }

        /// <summary>Ask for sealed sessions only. Call it before the first tick.</summary>
        /// <param name="key">The master's own key.</param>
        /// <param name="slavePublic">The slave's public key, 32 bytes.</param>
        /// <exception cref="HapticException">The slave's key is none, or the library has no seal.</exception>
        public void Seal(PrivateKey key, byte[] slavePublic)
        {
            PrivateKey.CheckLength(slavePublic, "the slave's public key");
            Native.Check(Native.hn_seal_master(_handle, key.Own, slavePublic, key.HasPsk ? key.Psk : null));
        }

        /// <summary>Give the position [m] of this period.</summary>
        public void Tick(double[] positionM, long nowUs)
        {
            CheckVector(positionM, "the position");
            Native.hn_master_tick(_handle, positionM, nowUs);
            Random.Check();
        }

        /// <summary>Do what is due in a period without a position.</summary>
        public void Tick(long nowUs)
        {
            Native.hn_master_tick(_handle, null, nowUs);
            Random.Check();
        }

        /// <summary>Write the force [N] to apply now. Limit it to what the device and a finger can bear.</summary>
        public void Force(double[] forceN, long nowUs)
        {
            CheckVector(forceN, "the force");
            Native.hn_master_force(_handle, forceN, nowUs);
        }

        /// <summary>Write the next datagram for the slave; return its size, or 0 if there is none.</summary>
        public int Send(byte[] datagram)
        {
            CheckBuffer(datagram);
            int size = (int)Native.hn_master_send(_handle, datagram);
            Random.Check();
            return size;
        }

        /// <summary>Take in a datagram. A bad one is counted and dropped.</summary>
        public void Receive(byte[] datagram, int size, long nowUs)
        {
            CheckSize(datagram, size, "the datagram");
            Native.hn_master_receive(_handle, datagram, (UIntPtr)size, nowUs);
            Random.Check();
        }

        /// <summary>End the session. Then go on until the state is closed, which takes at most 250 ms.</summary>
        public void Close(string reason, long nowUs)
        {
            Native.hn_master_close(_handle, Native.Bytes(reason ?? ""), nowUs);
        }

        /// <inheritdoc/>
        public override void Dispose()
        {
            _handle.Dispose();
        }

        internal override uint Count(byte[] name)
        {
            return Native.hn_master_count(_handle, name);
        }
    }
}
