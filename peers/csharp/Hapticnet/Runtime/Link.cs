using System;
using System.Net;
using System.Net.Sockets;
using System.Threading;

namespace Hapticnet
{
    /// <summary>What is at a master: a device, or something that moves. Both are called on the link's thread.</summary>
    public interface IHand
    {
        /// <summary>Write the position [m] now.</summary>
        void Read(double[] positionM);

        /// <summary>Apply this force [N]; a positive one pushes the tool out.</summary>
        void Apply(double[] forceN);
    }

    /// <summary>What is touched at a slave.</summary>
    public interface IScene
    {
        /// <summary>Write the force [N] at a position [m]; a positive one pushes the tool out.</summary>
        void Touch(double[] positionM, double[] forceN);
    }

    /// <summary>A thread with a socket that runs a node in real time.</summary>
    public abstract class Link : IDisposable
    {
        private readonly Thread _thread;
        private volatile bool _stopping;
        private volatile string _failure;

        internal Link(string name)
        {
            _thread = new Thread(RunUntilStopped) { IsBackground = true, Name = name };
            _thread.Priority = ThreadPriority.Highest;
        }

        /// <summary>What ended the link, one sentence; null while nothing has.</summary>
        public string Failure
        {
            get { return _failure; }
        }

        internal Socket Socket { get; } = new Socket(AddressFamily.InterNetwork, SocketType.Dgram, ProtocolType.Udp);

        internal bool IsStopping
        {
            get { return _stopping; }
        }

        /// <summary>End the session and the thread, and free everything. It takes up to 300 ms.</summary>
        public void Dispose()
        {
            _stopping = true;
            if (_thread.IsAlive && Thread.CurrentThread != _thread)
                _thread.Join(1000);
        }

        /// <summary>Return the address of a host; a name is looked up.</summary>
        internal static IPAddress AddressOf(string host)
        {
            IPAddress address;
            if (IPAddress.TryParse(host ?? "", out address) && address.AddressFamily == AddressFamily.InterNetwork)
                return address;
            try
            {
                IPAddress[] found = Dns.GetHostAddresses(host ?? "");
                address = Array.Find(found, each => each.AddressFamily == AddressFamily.InterNetwork);
            }
            catch (SocketException)
            {
            }
            if (address == null)
                throw new HapticException("'" + host + "' is no host with an IPv4 address");
            return address;
        }

        internal static void CheckPort(int port, int least)
        {
            if (port < least || port > 65535)
                throw new HapticException("the port is " + port + "; it must be " + least + " to 65535");
        }

        internal void Start()
        {
            _thread.Start();
        }

        internal abstract void Run();

        internal abstract void Free();

        private void RunUntilStopped()
        {
            try
            {
                Run();
            }
            catch (HapticException error)
            {
                _failure = error.Message;
            }
            catch (Exception error) // of a hand or a scene: the thread must not end the program
            {
                _failure = error.GetType().Name + ": " + error.Message;
            }
            finally
            {
                Socket.Close();
                Free();
            }
        }
    }

    /// <summary>A master over UDP, with a thread that ticks at the request's rate.</summary>
    /// <remarks>Once it runs, a tick allocates no memory, so that the garbage collector causes no pause.</remarks>
    public sealed class MasterLink : Link
    {
        private const int MostPerTick = 64;

        private readonly Master _master;
        private readonly IHand _hand;
        private readonly double _periodUs;
        private readonly double[] _positionM, _forceN;
        private readonly byte[] _sent = new byte[Node.DatagramBytes], _received = new byte[Node.ReceiveBytes];
        private volatile int _state;
        private volatile string _scene = "", _reason = "";
        private int _code;
        private long _ticks, _missed;

        /// <summary>Connect a hand to a slave, and go on doing so until this is disposed.</summary>
        /// <param name="host">The slave's host: an IPv4 address or a name.</param>
        /// <param name="port">The slave's UDP port.</param>
        /// <param name="request">What to ask for.</param>
        /// <param name="hand">What moves and is pushed.</param>
        /// <param name="key">The own key, for a sealed session; null: an open one.</param>
        /// <param name="slavePublic">The slave's public key, with a key of one's own.</param>
        /// <exception cref="HapticException">One of these is wrong, or the library is missing.</exception>
        public MasterLink(string host, int port, Request request, IHand hand, PrivateKey key = null,
            byte[] slavePublic = null)
            : base("hapticnet master")
        {
            CheckPort(port, 1);
            if (hand == null)
                throw new HapticException("a hand is needed");
            _hand = hand;
            _master = new Master(request);
            if (key != null)
                _master.Seal(key, slavePublic);
            _periodUs = 1e6 / (request.RateHz ?? 1000.0);
            _positionM = new double[request.Axes];
            _forceN = new double[request.Axes];
            var slave = new IPEndPoint(AddressOf(host), port);
            try
            {
                Socket.Connect(slave);
            }
            catch (SocketException error)
            {
                throw new HapticException(slave + " cannot be reached: " + error.Message);
            }
            Socket.Blocking = false;
            Start();
        }

        /// <summary>Where the session stands.</summary>
        public SessionState State
        {
            get { return (SessionState)_state; }
        }

        /// <summary>The name of the slave's scene; empty before the first session.</summary>
        public string Scene
        {
            get { return _scene; }
        }

        /// <summary>Why the slave refused, closed or warned, newest first; empty if it has not.</summary>
        public string Reason
        {
            get { return _reason; }
        }

        /// <summary>Ticks so far.</summary>
        public long Ticks
        {
            get { return Interlocked.Read(ref _ticks); }
        }

        /// <summary>Ticks that were left out, because the thread came more than a period late.</summary>
        public long MissedTicks
        {
            get { return Interlocked.Read(ref _missed); }
        }

        internal override void Run()
        {
            try
            {
                RunUntilClosed();
            }
            catch (Exception) // of the hand: the slave need not wait for it
            {
                _master.Close("the hand failed", Node.NowUs);
                SendAll();
                throw;
            }
            finally
            {
                Array.Clear(_forceN, 0, _forceN.Length);
                _hand.Apply(_forceN);
            }
        }

        internal override void Free()
        {
            _master.Dispose();
        }

        private void RunUntilClosed()
        {
            var pace = new Pace(_periodUs);
            bool closing = false;
            while (_state != (int)SessionState.Closed)
            {
                Interlocked.Add(ref _missed, pace.Wait());
                Interlocked.Increment(ref _ticks);
                ReceiveAll();
                if (IsStopping && !closing)
                {
                    closing = true;
                    _master.Close("done", Node.NowUs);
                }
                _hand.Read(_positionM);
                _master.Tick(_positionM, Node.NowUs);
                _master.Force(_forceN, Node.NowUs);
                _hand.Apply(_forceN);
                SendAll();
                if ((int)_master.State != _state || _master.ReasonCode != _code)
                    Tell();
            }
        }

        /// <summary>Let other threads know what has changed.</summary>
        private void Tell()
        {
            _scene = _master.Scene;
            _reason = _master.Reason;
            _code = _master.ReasonCode;
            _state = (int)_master.State;
        }

        private void ReceiveAll()
        {
            SocketError error;
            // A flood must not keep the hand waiting, which has the force of the last tick meanwhile.
            for (int left = MostPerTick; left > 0 && Socket.Available > 0; left--)
            {
                int size = Socket.Receive(_received, 0, _received.Length, SocketFlags.None, out error);
                if (error == SocketError.Success)
                    _master.Receive(_received, size, Node.NowUs);
            }
        }

        private void SendAll()
        {
            SocketError error; // a datagram that is not sent is lost, as on the way
            for (int size = _master.Send(_sent); size > 0; size = _master.Send(_sent))
                Socket.Send(_sent, 0, size, SocketFlags.None, out error);
        }
    }

    /// <summary>A slave over UDP, of one master at a time, with a thread that answers as datagrams arrive.</summary>
    public sealed class SlaveLink : Link
    {
        private const int PatienceMs = 50;
        private const int Failed = 6; // the protocol's code

        private readonly Slave _slave;
        private readonly IScene _scene;
        private readonly double[] _positionM, _forceN;
        private readonly byte[] _received = new byte[Node.ReceiveBytes], _answer = new byte[Node.DatagramBytes];
        private readonly byte[] _address = new byte[Slave.AddressBytes];
        private readonly IPEndPoint _master = new IPEndPoint(IPAddress.Any, 0);
        private EndPoint _from = new IPEndPoint(IPAddress.Any, 0);

        /// <summary>Serve a scene, until this is disposed.</summary>
        /// <param name="address">The own IPv4 address, such as 127.0.0.1, or 0.0.0.0 for all.</param>
        /// <param name="port">The own UDP port; 0: a free one.</param>
        /// <param name="name">The scene's name, for the master.</param>
        /// <param name="axes">Number of axes, 1 to 3.</param>
        /// <param name="scene">What is touched.</param>
        /// <param name="key">The own key, for sealed sessions; null: open ones.</param>
        /// <param name="masters">The masters that are served, with a key of one's own.</param>
        public SlaveLink(string address, int port, string name, int axes, IScene scene, PrivateKey key = null,
            System.Collections.Generic.IList<ListedMaster> masters = null)
            : base("hapticnet slave")
        {
            CheckPort(port, 0);
            if (scene == null)
                throw new HapticException("a scene is needed");
            _scene = scene;
            _slave = new Slave(name, axes);
            if (key != null)
                _slave.Seal(key, masters);
            _positionM = new double[axes];
            _forceN = new double[axes];
            try
            {
                Socket.Bind(new IPEndPoint(AddressOf(address), port));
            }
            catch (SocketException error)
            {
                throw new HapticException(address + ":" + port + " cannot be used: " + error.Message);
            }
            Port = ((IPEndPoint)Socket.LocalEndPoint).Port;
            Socket.ReceiveTimeout = PatienceMs;
            Start();
        }

        /// <summary>The UDP port.</summary>
        public int Port { get; private set; }

        internal override void Run()
        {
            try
            {
                while (!IsStopping)
                {
                    // Receive all that has arrived, and only then answer the newest position.
                    if (Socket.Available > 0 || !Answer())
                        ReceiveOne();
                }
            }
            catch (Exception) // of the scene: the master need not wait for it
            {
                SendToMaster(_slave.Close("the scene failed", Failed, _answer));
                throw;
            }
            SendToMaster(_slave.Close("done", 0, _answer));
        }

        internal override void Free()
        {
            _slave.Dispose();
        }

        private void ReceiveOne()
        {
            int size;
            try
            {
                size = Socket.ReceiveFrom(_received, ref _from);
            }
            catch (SocketException) // nothing has come for a while, or a master is gone
            {
                return;
            }
            var from = (IPEndPoint)_from;
            byte[] host = from.Address.GetAddressBytes();
            host.CopyTo(_address, 0);
            _address[host.Length] = (byte)(from.Port >> 8);
            _address[host.Length + 1] = (byte)from.Port;
            size = _slave.Receive(_received, size, _address, host.Length + 2, Node.NowUs, _answer);
            if (size > 0)
                Send(size, from);
        }

        private bool Answer()
        {
            if (!_slave.Position(_positionM))
                return false;
            _scene.Touch(_positionM, _forceN);
            SendToMaster(_slave.Answer(_forceN, Node.NowUs, _answer));
            return true;
        }

        private void SendToMaster(int size)
        {
            byte[] address = size > 0 ? _slave.MasterAddress : null;
            if (address == null)
                return;
            var host = new byte[address.Length - 2];
            Array.Copy(address, host, host.Length);
            _master.Address = new IPAddress(host);
            _master.Port = address[host.Length] << 8 | address[host.Length + 1];
            Send(size, _master);
        }

        private void Send(int size, EndPoint to)
        {
            try
            {
                Socket.SendTo(_answer, size, SocketFlags.None, to);
            }
            catch (SocketException) // it is lost, as on the way
            {
            }
        }
    }

    /// <summary>Waits for the next tick. It sleeps where the system's sleep is exact enough, and spins for the rest.
    /// </summary>
    internal sealed class Pace
    {
        // A sleep of a millisecond takes 1.1 ms on Linux, and up to 16 ms on Windows.
        private const double SleepUs = 1100.0, ShortestSleepUs = 600.0, LongUs = 3000.0, TryAgainUs = 60e6;
        private const int MostLong = 3;

        private readonly double _periodUs;
        private double _dueUs, _triedUs;
        private int _long; // sleeps in a row that took too long

        internal Pace(double periodUs)
        {
            _periodUs = periodUs;
            _dueUs = Node.NowUs;
        }

        /// <summary>Return at the time of the next tick, with the number of ticks that were missed.</summary>
        internal long Wait()
        {
            _dueUs += _periodUs;
            double nowUs = Node.NowUs;
            long missed = (long)Math.Max(0.0, Math.Floor((nowUs - _dueUs) / _periodUs));
            _dueUs += missed * _periodUs;
            while (nowUs < _dueUs)
            {
                bool fits = _dueUs - nowUs > Math.Max(SleepUs - _periodUs / 2.0, ShortestSleepUs);
                if (fits && (_long < MostLong || nowUs - _triedUs > TryAgainUs))
                    nowUs = Sleep(nowUs);
                else
                    nowUs = Yield();
            }
            return missed;
        }

        private static double Yield()
        {
            Thread.Yield();
            return Node.NowUs;
        }

        private double Sleep(double nowUs)
        {
            Thread.Sleep(1);
            _triedUs = Node.NowUs;
            _long = _triedUs - nowUs > LongUs ? _long + 1 : 0;
            return _triedUs;
        }
    }
}
